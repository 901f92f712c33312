"""What many tests need: the mini kicker's experiments, loaded once."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import pytest

# Tests are many small tensors: threads of torch would only wait for each other. Runs set their own number.
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_configure(config: pytest.Config) -> None:
    """Gives each of several test processes a core of its own: physics takes all that it may use."""
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker is not None:
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker.removeprefix("gw")) % len(cores)]})


ROOT = Path(__file__).parent.parent


@cache
def _experiment(task: str, method: str, overrides: tuple[str, ...]):
    from kickbench.trials.trial import load_trial

    return load_trial(
        ROOT / "tasks" / f"{task}.yaml", ROOT / "methods" / "mini" / f"{method}.yaml", overrides
    )


@pytest.fixture(scope="session")
def experiment():
    """Loads a mini experiment: `experiment(task, method, *overrides)`."""

    def load(task: str = "mini_home_field", method: str = "baseline", *overrides: str):
        return _experiment(task, method, overrides)

    return load
