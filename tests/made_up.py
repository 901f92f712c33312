"""Results that are made up, for tests of what is concluded from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kickbench.results.atomic import atomic_write_bytes
from kickbench.results.identity import Identity, _sha256, write_identity
from kickbench.results.metrics import Evaluation, Metrics, metrics_bytes
from kickbench.results.store import RunDirectory


def made_up_metrics(
    evaluation: Evaluation, provenance: dict[str, Any] | None = None, **values: Any
) -> Metrics:
    """A result on `mini_home_field`; what a test does not depend on is made up.

    Args:
        evaluation: Its figures.
        provenance: What its provenance has instead of what is made up.
        values: What the result has instead of what is made up.
    """
    known = {
        "task": "mini_home_field",
        "method": "baseline",
        "seed": 0,
        "iterations": 390,
        "env_steps": 1000,
        "training_seconds": 100.0,
        **values,
    }
    source = {
        "versions": {"python": "3.11.7"},
        "device": "a processor",
        "num_threads": 2,
        "platform": "Linux",
        "seed": known["seed"],
        "commit": None,
        "dirty": None,
        "started": "2026-01-01T00:00:00+00:00",
        "finished": "2026-01-01T00:02:00+00:00",
        "seconds": 20 + known["training_seconds"],
        "env_steps": known["env_steps"],
        "command": ["kickbench", "run"],
        **(provenance or {}),
    }
    return Metrics.model_validate({**known, "evaluation": evaluation, "provenance": source})


def write_metrics(path: Path, metrics: Metrics) -> None:
    """Writes a `metrics.json`."""
    atomic_write_bytes(path, metrics_bytes(metrics))


def write_result(path: Path, metrics: Metrics, identity: Identity | None = None) -> None:
    """Makes a folder a finished run.

    Args:
        path: The folder.
        metrics: Its result.
        identity: Its identity; default: one that runs share whose task and method have the same names.
    """
    parts = {"task": _sha256(metrics.task), "method": _sha256(metrics.method), "model": _sha256({})}
    made_up = Identity(fingerprint=_sha256(parts), parts=parts, model_arrays={})
    directory = RunDirectory(path)
    write_identity(directory.path, identity or made_up)
    directory.finish(metrics)
