"""Verbs `render` and `play`, and `show --plot`."""

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


def play(arguments: argparse.Namespace) -> int:
    """`kickbench play RUN|TASK`: a policy, or a robot without one, live in a browser."""
    check_mujoco()
    from kickbench.mdp.catalog import task_model
    from kickbench.mdp.compile import compile_task
    from kickbench.results.store import RunDirectory
    from kickbench.spec.load import load_task
    from kickbench.view.play import play as show
    from kickbench.view.recording import policy_for

    path: Path = arguments.path
    run = path if path.is_dir() else None
    if run is None and arguments.task is not None:
        raise KickbenchError(f"--task is for a run's policy, and {shown(path)} is not a run directory")
    file = arguments.task or (RunDirectory(path).task_spec if run else path)
    if run and not RunDirectory(path).task_spec.is_file():
        raise KickbenchError(f"{shown(path)}: not a run directory (it has no specs/task.yaml)")
    task = compile_task(load_task(task_model(), file, arguments.overrides))
    policy = policy_for(task, run) if run else None
    show(
        task,
        policy,
        f"kickbench play {shown(path)}",
        seed=task.spec.evaluation.seed if arguments.seed is None else arguments.seed,
        host=arguments.host,
        port=arguments.port,
        browser=arguments.browser,
    )
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
        _refuse(arguments, "a .png shows starts", "policy", "episodes")
        return _sheet
    if suffix in (".gif", ".mp4"):
        _refuse(arguments, f"a {suffix} shows episodes", "starts")
        return _film
    raise KickbenchError(f"{out}: pictures are .png, .gif or .mp4")


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
    from kickbench.view.recording import policy_for, record_episodes
    from kickbench.view.starts import evaluation_starts
    from kickbench.view.video import check_mp4, film, frame_time, write_gif, write_mp4

    size, is_mp4 = arguments.size or _FILM_SIZE, out.suffix.lower() == ".mp4"
    if is_mp4:
        check_mp4(*size)
    policy = policy_for(task, arguments.policy) if arguments.policy else None
    starts = evaluation_starts(task, arguments.episodes or _EPISODES, seed)
    frames = film(task, record_episodes(task, policy, starts, seed), *size)
    (write_mp4 if is_mp4 else write_gif)(out, frames, frame_time(task))
