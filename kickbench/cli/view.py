"""Verb `render`, and `show --plot`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from kickbench.errors import KickbenchError, shown
from kickbench.view.backend import check_mujoco

if TYPE_CHECKING:
    from kickbench.mdp.compile import CompiledTask

_STARTS, _EPISODES = 9, 3
_SHEET_SIZE, _FILM_SIZE = (400, 300), (640, 480)


def render(arguments: argparse.Namespace) -> int:
    """`kickbench render TASK`: a contact sheet of starts, or a film of episodes."""
    check_mujoco()
    draw = _render_of(arguments)
    from kickbench.mdp.catalog import task_model
    from kickbench.mdp.compile import compile_task
    from kickbench.spec.load import load_task

    task = compile_task(load_task(task_model(), arguments.task, arguments.overrides))
    out = arguments.out or Path(f"{task.name}.png")
    seed = task.spec.evaluation.seed if arguments.seed is None else arguments.seed
    draw(task, out, seed, arguments)
    print(shown(out))
    return 0


def plot(arguments: argparse.Namespace) -> int:
    """`kickbench show TASK --plot FILE`: sampling regions from above."""
    from kickbench.mdp.catalog import task_model
    from kickbench.mdp.compile import compile_task
    from kickbench.spec.load import load_task
    from kickbench.speccheck import kind_of
    from kickbench.view.regions import plot_regions
    from kickbench.yamlio import load_document

    kind = kind_of(load_document(arguments.file))
    if kind != "task":
        raise KickbenchError(
            f"--plot draws the sampling regions of a task; {arguments.file} is a {kind} file"
        )
    plot_regions(compile_task(load_task(task_model(), arguments.file, arguments.overrides)), arguments.plot)
    print(shown(arguments.plot))
    return 0


def _render_of(arguments: argparse.Namespace) -> Callable[..., None]:
    """What the suffix of the output asks for.

    Raises:
        KickbenchError: Another suffix, or an option that the suffix has no use for.
    """
    out = arguments.out
    suffix = out.suffix.lower() if out else ".png"
    if suffix == ".png":
        _refuse(arguments, "a .png shows starts", "policy", "episodes", "mirrored")
        return _sheet
    if suffix in (".webp", ".mp4"):
        _refuse(arguments, f"a {suffix} shows episodes", "starts")
        return _film
    raise KickbenchError(f"{out}: pictures are .png, .webp or .mp4")


def _refuse(arguments: argparse.Namespace, reason: str, *options: str) -> None:
    for option in options:
        if getattr(arguments, option) is not None:
            raise KickbenchError(f"--{option}: {reason}")


def _sheet(task: CompiledTask, out: Path, seed: int, arguments: argparse.Namespace) -> None:
    from kickbench.results.atomic import atomic_file
    from kickbench.view.contact_sheet import contact_sheet

    sheet = contact_sheet(task, arguments.starts or _STARTS, seed, *(arguments.size or _SHEET_SIZE))
    with atomic_file(out) as file:
        sheet.save(file, "PNG")


def _film(task: CompiledTask, out: Path, seed: int, arguments: argparse.Namespace) -> None:
    from kickbench.view.film import film_runs

    size, episodes = arguments.size or _FILM_SIZE, arguments.episodes or _EPISODES
    film_runs(task, arguments.policy or [], out, episodes, seed, size, mirrored=arguments.mirrored or False)
