"""A wheel brings everything that it needs: tasks, methods, robots and experiments too."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
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


TINY = ("--iterations", "1", "--num-envs", "16", "--set", "evaluation.episodes=8")


def interpreters(name: str) -> Iterator[str]:
    """Interpreters of this name that start: on the path, or those of pyenv."""
    found = [
        shutil.which(name),
        *Path.home().glob(f".pyenv/versions/{name.removeprefix('python')}.*/bin/{name}"),
    ]
    for path in filter(None, found):
        if subprocess.run([path, "-c", ""], capture_output=True, check=False).returncode == 0:
            yield str(path)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["python3.12", "python3.13"])
def test_other_interpreters_install_and_train(name, tmp_path):
    python = next(interpreters(name), None)
    if python is None:
        pytest.skip(f"no {name} here")
    subprocess.run([python, "-m", "venv", str(tmp_path / "venv")], check=True)
    bin = tmp_path / "venv/bin"
    pinned = ("-c", str(ROOT / "constraints.txt"), str(ROOT))
    subprocess.run(
        [bin / "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check", *pinned],
        check=True,
    )
    own = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    train = [bin / "kickbench", "run", "mini_home_field", "equivariant", *TINY, "--out", "run"]
    done = subprocess.run(train, cwd=tmp_path, env=own, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run/metrics.json").is_file()


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
    kickbench("run", "mine.yaml", "equivariant", *TINY)
    run = tmp_path / "runs/mine/equivariant/seed0"
    assert (run / "metrics.json").is_file()
    kickbench("eval", str(run))
