"""Exports of recorded runs."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

MEASURED = Path(__file__).parents[2] / "results/measured"


@cache
def _exported(name: str, folder: Path) -> tuple[Path, Path]:
    from kickbench.deploy.export import export

    run = MEASURED / name
    return run, export(run, folder / name, states=200)


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """Exports a recorded run once: `run, folder = exported("mini_home_field/baseline/seed0")`."""
    folder = tmp_path_factory.mktemp("exported")
    return lambda name: _exported(name, folder)
