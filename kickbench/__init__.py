"""kickbench: a declarative benchmark suite for symmetry-aware humanoid reinforcement learning.

From Python (names of tasks and methods are those of `tasks/` and `methods/`; paths do as well):

    env = kickbench.make("mini_home_field", num_envs=64, seed=0)     a `KickEnv`, torch in and out
    run = kickbench.train("mini_home_field", "mini/equivariant")     what `kickbench run` does; a `Run`
    run = kickbench.load_run("runs/mini_home_field/equivariant/seed0")
    actions = run.policy(observations)                               numpy or torch; run.specs, run.metrics
    figures = kickbench.evaluate(run, episodes=500)                  an `Evaluation`
    assert kickbench.check_mirror("robot.xml", my_mirror_function, my_observe)  see `kickbench symmetry check`
    table = kickbench.load_runs("results/measured")                  pandas.DataFrame: a row per run and side

`import kickbench.envs.gym` registers every task with Gymnasium; `kickbench.deploy.runner.Policy` runs an
exported policy.
Nothing heavy is imported before a name is used. Wrong specifications and files raise
`kickbench.KickbenchError`.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Before torch loads libgomp, which reads it once. Threads that wait for work would otherwise spin on cores
# that another process, or the physics, could use: beside three busy processes an update of the K1's networks
# then takes several times as long. Passive waiting costs an idle machine 5 to 8 % of a K1 iteration; a
# bounded spin (GOMP_SPINCOUNT=1000) costs it 1 %, but makes updates 1.4 times as long on a busy one.
if "GOMP_SPINCOUNT" not in os.environ:
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

if TYPE_CHECKING:
    from kickbench.audit.foreign import check_mirror
    from kickbench.envs.env import KickEnv, make
    from kickbench.errors import KickbenchError
    from kickbench.launch.run import evaluate, train
    from kickbench.results.frame import load_runs
    from kickbench.training.trained import Run, load_run

__version__ = "0.2.0"
__all__ = [
    "KickEnv",
    "KickbenchError",
    "Run",
    "check_mirror",
    "evaluate",
    "load_run",
    "load_runs",
    "make",
    "train",
]

_HOME = {
    "KickEnv": "envs.env",
    "KickbenchError": "errors",
    "Run": "training.trained",
    "check_mirror": "audit.foreign",
    "evaluate": "launch.run",
    "load_run": "training.trained",
    "load_runs": "results.frame",
    "make": "envs.env",
    "train": "launch.run",
}


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'kickbench' has no attribute '{name}'")
    return getattr(import_module(f"kickbench.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
