"""`kickbench bench --device cuda --proof`: checks and records what runs on a graphics card, for that card."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from pydantic import Field

from kickbench.bench.figures import SizeFigures
from kickbench.bench.measure import Iterations, measure_size
from kickbench.config.shipped import find, find_method, root
from kickbench.envs.engines import make_engine, make_warp_engine, rehearsal
from kickbench.results.atomic import Record, atomic_write_text, check_writable
from kickbench.results.provenance import Provenance, collect_provenance, device_name
from kickbench.trials.trial import Trial, load_trial

_QPOS, _QVEL = 5e-5, 5e-3
"""How far a control step may end from the CPU engine's, in 99 % of them: m and rad, m/s and rad/s. The GPU
computes in single precision, so that a contact may begin a substep later."""
_STEPS = 20


class Check(Record):
    """One thing that was tried on a card."""

    name: Literal["tests", "parity", "bench", "training"]
    passed: bool | None
    """Whether it is as it should be; null: it could not be tried."""
    remark: str = ""
    """Why it failed, or could not be tried."""
    figures: dict[str, float] = Field(default_factory=dict)
    """parity: differences between the engines; training: some of the iteration's figures."""
    sizes: tuple[SizeFigures, ...] = ()
    """bench: its figures."""


class Proof(Record):
    """The file `results/gpu/<card>.json`."""

    schema_version: Literal[1] = 1
    card: str
    cuda: str | None
    """CUDA version of torch."""
    checks: tuple[Check, ...]
    provenance: Provenance

    @property
    def passed(self) -> bool:
        """Whether everything was tried and nothing failed."""
        return all(check.passed for check in self.checks)


def folder() -> Path:
    """Where the files of proved cards are."""
    return root() / "results/gpu"


def proved_cards() -> list[Proof]:
    """What has been written down of cards."""
    return [Proof.model_validate_json(file.read_bytes()) for file in sorted(folder().glob("*.json"))]


def prove(trials: dict[str, Trial], device: str, threads: int, rounds: int) -> tuple[Proof, Path]:
    """Tries everything on a device, prints each outcome, and writes the file.

    Args:
        trials: Method name -> trial, as `measure_size` has them.
        device: Torch device, checked before.
        threads: Threads of physics, where it runs on the CPU.
        rounds: Rounds of the bench.

    Raises:
        KickbenchError: The file cannot be written; nothing was tried.
    """
    started, card = time.monotonic(), device_name(device)
    file = folder() / f"{re.sub(r'[^a-z0-9]+', '-', card.lower()).strip('-')}.json"
    check_writable(file)
    parts: dict[str, Callable[[], Check]] = {
        "tests": run_tests,
        "parity": partial(compare_engines, next(iter(trials.values())), device),
        "bench": lambda: Check(
            name="bench", passed=True, sizes=(measure_size(trials, device, threads, rounds),)
        ),
        "training": partial(train_once, device, threads),
    }
    checks = tuple(_tried(parts))
    origin = collect_provenance(
        seed=0, env_steps=0, started=started, num_threads=threads, device=device, argv=sys.argv
    )
    proof = Proof(card=card, cuda=torch.version.cuda, checks=checks, provenance=origin)
    atomic_write_text(file, proof.model_dump_json(indent=2) + "\n")
    return proof, file


def _tried(parts: dict[str, Callable[[], Check]]) -> Iterator[Check]:
    for name, part in parts.items():
        try:
            check = part()
        except Exception as error:  # whatever a driver raises is what the file is to say
            text = " ".join(str(error).split()) or type(error).__name__
            check = Check.model_validate({"name": name, "passed": False, "remark": text})
        verdict = {True: "passed", False: "FAILED", None: "not tried"}[check.passed]
        figures = ", ".join(f"{key} {value:.3g}" for key, value in check.figures.items())
        print(": ".join(filter(None, (f"{name:8}  {verdict}", check.remark, figures))), flush=True)
        yield check


def run_tests() -> Check:
    """The tests that need a GPU, where the tests are."""
    tests = root() / "tests"
    if not tests.is_dir():
        return Check(name="tests", passed=None, remark="this installation has no tests; use a checkout")
    command = [sys.executable, "-m", "pytest", "-q", "-m", "cuda", str(tests)]
    done = subprocess.run(command, cwd=root(), capture_output=True, text=True, check=False)
    last = (done.stdout.strip() or done.stderr.strip()).splitlines()[-1:]
    passed = done.returncode == 0 and "passed" in "".join(last)
    return Check(name="tests", passed=passed, remark="".join(last).strip("= "))


def compare_engines(trial: Trial, device: str) -> Check:
    """Control steps of mujoco_warp beside MuJoCo's, each from the very state that mujoco_warp has reached."""
    states, targets = rehearsal(trial.task)
    engine, reference = (
        make(trial.task, len(states), d) for make, d in ((make_warp_engine, device), (make_engine, "cpu"))
    )
    everywhere, differences = torch.ones(len(states), dtype=torch.bool), []
    at_rest = states.new_zeros(len(states), trial.task.scene.model.nv)
    engine.reset(*(tensor.to(engine.device) for tensor in (everywhere, states, at_rest)))
    for target in targets[:_STEPS]:
        reference.reset(everywhere, engine.qpos.double().cpu(), engine.qvel.double().cpu())
        reference.step(target.float())
        engine.step(target.float().to(engine.device))
        pairs = ((engine.qpos, reference.qpos), (engine.qvel, reference.qvel))
        differences.append(torch.stack([(a.cpu() - b).abs().amax(dim=1) for a, b in pairs], dim=1))
    found = torch.cat(differences)
    usual, most = found.quantile(0.99, dim=0).tolist(), found.amax(dim=0).tolist()
    figures = {"qpos 99 %": usual[0], "qvel 99 %": usual[1], "qpos most": most[0], "qvel most": most[1]}
    return Check(name="parity", passed=usual[0] < _QPOS and usual[1] < _QVEL, figures=figures)


def train_once(device: str, threads: int) -> Check:
    """An iteration with the thesis' hyperparameters (Table B.1), after one that is not counted."""
    task = find("k1_general_fast", "task")
    training = Iterations(load_trial(task, find_method("equivariant", task)), device, threads)
    training()
    record = training()
    names = ("steps_per_second", "collect_seconds", "update_seconds", "resets_nonfinite", "load/short_share")
    figures = {name: float(record[name]) for name in names if name in record}
    return Check(name="training", passed=True, figures=figures)
