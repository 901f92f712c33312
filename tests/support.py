"""What tests of several rooms call: the command line, complaints, equality of runs, small trainings."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from kickbench.cli import main
from kickbench.errors import SpecError
from kickbench.results.metrics import load_metrics

CLOCK = ("steps_per_second", "collect_seconds", "update_seconds", "crc32")
PATIENCE = float(os.environ.get("KICKBENCH_TEST_PATIENCE", "900"))
"""How long tests wait for other processes, s; much, as the machine may be busy."""


def printed(capsys: pytest.CaptureFixture[str], *arguments: str | Path, code: int = 0) -> str:
    """What the command line prints; it must end with this exit code."""
    assert main([str(argument) for argument in arguments]) == code
    return capsys.readouterr().out


def complaints_of(call: Callable[..., object], *arguments: Any) -> list[str]:
    """The problems that a call must raise, as people read them."""
    with pytest.raises(SpecError) as error:
        call(*arguments)
    return [str(problem) for problem in error.value.problems]


def untimed_rows(table: Path) -> list[dict[str, str]]:
    """A progress table without what the clock has measured."""
    with open(table, encoding="utf-8", newline="") as file:
        return [{k: v for k, v in row.items() if k not in CLOCK} for row in csv.DictReader(file)]


SMALL = (
    "algorithm.num_envs=16",
    "algorithm.steps_per_env=8",
    "network.actor_hidden=[16]",
    "network.critic_hidden=[16]",
)
"""Overrides that make an iteration cheap."""


def assert_same_bits(one: Any, other: Any) -> None:
    """Equality to the last bit of nested dicts and lists of tensors and numbers."""
    assert type(one) is type(other)
    if isinstance(one, torch.Tensor):
        assert one.dtype == other.dtype
        assert torch.equal(one, other)
    elif isinstance(one, dict):
        assert list(one) == list(other)
        for key in one:
            assert_same_bits(one[key], other[key])
    elif isinstance(one, list | tuple):
        assert len(one) == len(other)
        for left, right in zip(one, other, strict=True):
            assert_same_bits(left, right)
    else:
        assert one == other


def assert_same_run(one: Path, other: Path) -> None:
    """Equality of two finished runs in all but times."""
    assert_same_bits(*(torch.load(run / "policy.pt", weights_only=True) for run in (one, other)))
    assert untimed_rows(one / "progress.csv") == untimed_rows(other / "progress.csv")
    assert (one / "episodes.csv").read_bytes() == (other / "episodes.csv").read_bytes()
    clock = {"training_seconds", "provenance"}
    ours, theirs = (load_metrics(run / "metrics.json").model_dump(exclude=clock) for run in (one, other))
    assert ours == theirs


def wait_for(condition: Callable[[], Any], what: str) -> Any:
    """Waits until something is true or not None; what that is."""
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline, f"never: {what}"
        time.sleep(0.05)
    return found
