from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kickbench.cli import main

ROOT = Path(__file__).parents[2]
TASK = str(ROOT / "tasks" / "mini_home_field.yaml")


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_render_draws_a_sheet_named_after_the_task(opengl, place, capsys):
    assert main(["render", TASK, "--initial-states", "2", "--size", "96x72"]) == 0
    assert capsys.readouterr().out == "mini_home_field.png\n"
    image = Image.open("mini_home_field.png")
    assert image.size == (2 * 96, 72)
    assert np.asarray(image).std() > 10


def test_the_same_seed_draws_the_same_sheet_and_another_one_another(opengl):
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        assert (
            main(
                [
                    "render",
                    TASK,
                    "--initial-states",
                    "1",
                    "--size",
                    "96x72",
                    "--seed",
                    seed,
                    "--out",
                    f"{name}.png",
                ]
            )
            == 0
        )
    a, b, c = (Path(f"{name}.png").read_bytes() for name in "abc")
    assert a == b != c


def test_render_films_a_short_episode(opengl):
    short = ["--set", "episode.max_steps=6", "--episodes", "1", "--size", "96x72"]
    assert main(["render", TASK, "--out", "a.webp", *short]) == 0
    assert Image.open("a.webp").n_frames >= 3


SHEET = "a .png shows initial states: no --policy, --episodes or --mirrored"
ERRORS = {
    "unknown kind of picture": (
        ["render", TASK, "--out", "a.jpg"],
        "a.jpg: pictures are .png or .webp",
    ),
    "policy for a sheet": (["render", TASK, "--policy", "runs/x"], SHEET),
    "episodes for a sheet": (["render", TASK, "--episodes", "2"], SHEET),
    "starts for a film": (
        ["render", TASK, "--out", "a.webp", "--initial-states", "2"],
        "a .webp shows episodes: no --initial-states",
    ),
    "no such run": (
        ["render", TASK, "--out", "a.webp", "--policy", "runs/x"],
        "runs/x: no such directory",
    ),
    "no such task": (
        ["render", "x.yaml"],
        "x.yaml: no such file, and no task of this name (`kickbench list` prints the names)",
    ),
}


@pytest.mark.parametrize("name", ERRORS)
def test_a_wrong_command_is_answered_in_one_line_and_writes_nothing(name, place, capsys):
    argv, message = ERRORS[name]
    assert main(argv) == 2
    assert capsys.readouterr().err == f"{message}\n"
    assert not list(place.iterdir())


@pytest.mark.parametrize("size", ["100", "100x", "10x10", "100x9999", "axb"])
def test_a_wrong_size_is_a_usage_error(capsys, size):
    with pytest.raises(SystemExit) as stop:
        main(["render", TASK, "--size", size])
    assert stop.value.code == 2
    assert f"'--size': expected WIDTHxHEIGHT, each from 64 to 4096, found '{size}'" in capsys.readouterr().err


def test_a_wrong_opengl_platform_is_an_error_without_a_traceback():
    done = subprocess.run(
        [sys.executable, "-m", "kickbench", "render", TASK],
        env={**os.environ, "MUJOCO_GL": "nonsense", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("no OpenGL to draw with (MUJOCO_GL=nonsense: ")
    assert "Traceback" not in done.stderr
