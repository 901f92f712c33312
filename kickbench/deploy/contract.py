"""The contract of an exported policy: what a robot or a simulator must do around the network.

    x[i]      = clip((value[i] - offset[i]) * scale[i])     every observation, in the order of `observations`
    action    = network(x)                                  the observation normaliser is inside
    target[j] = clip(default[j] + scale[j] * action[j])     every actuator, in the order of `actions`
    tau       = servo(target)                               as an action's `kind` and `velocity_limit` say

once in every `control_interval`. `value` is the quantity itself, in SI units: of `joint_pos` the positions of
the joints, from which `offset`, the default pose, is subtracted.

It is the file `policy.json`, and the metadata `kickbench` of `policy.onnx`:

| key | content |
|---|---|
| `format` | version of this layout |
| `input`, `output` | names of the network's input [batch, n] and output [batch, nu], float32 |
| `base` | body whose frame is the base frame: x forward, y left, z up |
| `control_interval` | time between two actions, s |
| `observations` | fields of the observation vector, in order |
| `joints` | observed joints, in the order of the observations of joints |
| `actions` | actuators, in the order of the action vector |
| `mirror` | of `observations` and `actions` in the xz plane: `mirrored[i] = sign[i] * x[index[i]]` |
| `mirror.equivariant` | whether the network commutes with it by construction |
| `training` | what the policy was trained in; a simulator that differs tests how robust it is |
| `origin` | where the policy comes from |

An observation; every list has one entry per number:

| key | content |
|---|---|
| `name`, `description`, `units` | the term; its numbers, `offset` and `scale` applied; unit of the value |
| `frame` | frame of a vector: that of the body `base`, or the world's; null: not a vector |
| `components` | what the numbers are: axes, sides, joints or actuators |
| `offset`, `scale` | subtracted from the value (the default pose of joint positions, else 0); factor |
| `clip` | range into which the numbers are clipped; null: none |
| `noise` | half-width of the uniform noise that each number had in training |
| `rate` | samples a second in training, Hz, each held until the next; null: one a control step |
| `dropout` | probability in training that a sample was lost and the last one held; null: 0 |
| `delay` | smallest and largest age of a sample in training, s, one age an episode; null: 0 |

A joint has its `name` in the MJCF, its position in the `default` pose and its `range` (null: no limits), rad
or m. An action has the gains and limits of `kickbench.config.robot.ActuatorSpec`, the actuator's `name`, and
as `default` the target of a zero action, rad, m, rad/s or m/s. A position servo with a `velocity_limit` has
tau = clip(kp (u - q) - max(kd - s, 0) dq, +-effort) - s dq with s = effort / velocity_limit; other servos
have tau = clip(law, +-effort).

`training` has `simulation`, `ball`, `floor` and `episode` of the task; the `feet`, whose friction decides in
their contact with the floor; the `terminations` with their parameters; `success_radius`, the largest distance
of ball and target of a successful kick, m; and `action_delay`, the latency of targets, null: none. Servos
follow the newest target of at least a certain age, drawn anew in every control step, uniform over whole
physics steps: `delay` is the smallest and largest age, s, `hold_probability` that of one more physics step.

`origin` has the versions that exported it (`kickbench`) and that trained it (`trained_with`); `task`,
`method` and `seed`; `samples`, control steps of training over all envs; `identity`, the fingerprint of the
run; and `policy`, the SHA-256 of its `policy.pt`.
"""

from __future__ import annotations

import hashlib
import re
from typing import Any

import numpy as np
from pydantic_core import to_json

from kickbench import __version__
from kickbench.config.terms import TerminationParams
from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.term import Field
from kickbench.results.identity import read_identity
from kickbench.sim.layout import SceneLayout
from kickbench.training.trained import Run
from kickbench.trials.trial import symmetry_of

_SIDES, _AXES = ("left", "right"), ("x", "y", "z")
_COMPONENTS = {
    "regular": _SIDES,
    "trivial + sign": _AXES[:2],
    "trivial + sign + trivial": _AXES,
    "sign + trivial + sign": _AXES,
}
"""What the numbers of an observation are, by its representation."""


def contract_of(run: Run) -> dict[str, Any]:
    """The contract of a run's policy, by the keys above.

    Raises:
        KickbenchError: The run has no result or no identity.
    """
    task, robot, method = run.trial.task, run.specs.robot, run.specs.method
    symmetry = symmetry_of(task, run.trial.method.representations)
    layout = task.scene.layout
    joints = zip(layout.joint_names, _default_pose(layout), layout.joint_range.tolist(), strict=True)
    actions = zip(robot.actuators.items(), layout.default_target.tolist(), strict=True)
    mirror = {"observations": symmetry.groups["actor"].representation, "actions": symmetry.actions}
    return {
        "format": 1,
        "input": "observation",
        "output": "action",
        "base": robot.base,
        "control_interval": task.spec.simulation.control_interval,
        "observations": [_observation(task, field) for field in task.groups["actor"]],
        "joints": [
            {"name": name, "default": default, "range": bounds if np.isfinite(bounds).all() else None}
            for name, default, bounds in joints
        ],
        "actions": [{**spec.model_dump(), "name": name, "default": of} for (name, spec), of in actions],
        "mirror": {
            **{name: {"index": r.permutation, "sign": r.signs} for name, r in mirror.items()},
            "equivariant": method.network.type == "equivariant" and not method.symmetry.exclude,
        },
        "training": _training(task),
        "origin": _origin(run),
    }


def contract_text(contract: dict[str, Any]) -> str:
    """A contract as JSON, every list of plain values on one line."""

    def joined(values: re.Match[str]) -> str:
        return f"[{' '.join(map(str.strip, values[1].splitlines()))}]"

    return re.sub(r"\[\n([^\[\]{}]*)\n\s*\]", joined, to_json(contract, indent=2).decode()) + "\n"


def _default_pose(layout: SceneLayout) -> list[float]:
    return layout.default_qpos[layout.joint_qpos].tolist()


def _observation(task: CompiledTask, field: Field) -> dict[str, Any]:
    term, layout = field.term, task.scene.layout
    own = {"joints": layout.joint_names, "actions": layout.actuator_names, "feet": layout.feet}
    own["obstacles"] = tuple(map(str, range(layout.obstacles.observed if layout.obstacles else 0)))
    known = _COMPONENTS | own
    names = known.get(str(term.representation))
    things, _, of_one = str(term.representation).partition(" x ")
    if of_one:
        inner = known.get(of_one.strip("()"), ())
        names = [f"{thing}_{part}" for thing in known.get(things, ()) for part in inner]
    return {
        "name": field.name,
        "description": " ".join(term.description.split()),
        "units": term.units,
        "frame": term.frame,
        "components": names or [str(number) for number in range(field.size)],
        "offset": _default_pose(layout) if term.from_default else [0.0] * field.size,
        "scale": [1.0] * field.size,
        **{key: getattr(field.params, key) for key in ("clip", "noise", "rate", "dropout", "delay")},
    }


def _training(task: CompiledTask) -> dict[str, Any]:
    spec = task.spec
    delay: Any = next((bound.params for bound in task.processes if bound.term.stage == "command"), None)
    return {
        **{name: getattr(spec, name).model_dump() for name in ("simulation", "ball", "floor")},
        "feet": task.robot.spec.feet and task.robot.spec.feet.model_dump(),
        "episode": spec.episode.model_dump(),
        "terminations": {
            name: params.model_dump() for name, params in spec.terminations.active(TerminationParams).items()
        },
        "success_radius": spec.evaluation.success_radius,
        "action_delay": delay and {"delay": delay.delay, "hold_probability": delay.hold_probability},
    }


def _origin(run: Run) -> dict[str, Any]:
    metrics = run.metrics
    return {
        "kickbench": __version__,
        "trained_with": metrics.provenance.versions,
        **{name: getattr(metrics, name) for name in ("task", "method", "seed")},
        "samples": metrics.env_steps,
        "identity": read_identity(run.directory).fingerprint,
        "policy": hashlib.sha256(run.directory.policy.read_bytes()).hexdigest(),
    }
