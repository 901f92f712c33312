"""A wheel brings everything that it needs: tasks, methods, robots and experiments too."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder that kickbench is installed in from a wheel, without its dependencies."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", str(folder), str(ROOT)], check=True)
    (wheel,) = folder.glob("kickbench-*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", str(folder / "site"), str(wheel)], check=True)
    return folder / "site"


@pytest.mark.slow
def test_names_work_from_an_empty_folder(installed, tmp_path):
    def kickbench(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "kickbench", *arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(installed)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    listed = kickbench("list")
    for name in ("mini_home_field", "mini/equivariant", "booster_k1", "general_fast"):
        assert name in listed.split()
    assert f"{installed}/kickbench/_shipped/tasks/mini_home_field.yaml:" in kickbench(
        "show", "mini_home_field"
    )
    assert kickbench("new", "task", "mine", "--from", "mini_home_field") == "mine.yaml\n"
    tiny = ("--iterations", "1", "--num-envs", "16", "--set", "evaluation.episodes=8")
    kickbench("run", "mine.yaml", "equivariant", *tiny)
    run = tmp_path / "runs/mine/equivariant/seed0"
    assert (run / "metrics.json").is_file()
    kickbench("eval", str(run))
