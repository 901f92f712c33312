"""Pictures and films of a task."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from kickbench.errors import KickbenchError, shown
from kickbench.view.backend import check_mujoco

if TYPE_CHECKING:
    from kickbench.envs.compile import CompiledTask

_STARTS, _EPISODES = 9, 3
_SHEET_SIZE, _FILM_SIZE = (400, 300), (640, 480)


class Picture(NamedTuple):
    """What is drawn; None: the default, which is none for the policy.

    Attributes:
        policy: Run directories, shown side by side.
        starts: Initial states on a sheet.
        episodes: Episodes of a film.
        seed: Seed of the initial states.
        size: Width and height, pixels.
        mirrored: Whether the mirror images of the starts are filmed.
    """

    policy: Sequence[Path] | None
    starts: int | None
    episodes: int | None
    seed: int | None
    size: tuple[int, int] | None
    mirrored: bool | None


def render(file: Path, out: Path | None, overrides: Sequence[str], picture: Picture) -> int:
    """Draws a contact sheet of initial states, or a film of episodes."""
    check_mujoco()
    draw = _render_of(out, picture)
    from kickbench.config.load import load_task
    from kickbench.envs.catalog import model_of_task
    from kickbench.envs.compile import compile_task

    task = compile_task(load_task(model_of_task, file, overrides))
    out = out or Path(f"{task.name}.png")
    draw(task, out, task.spec.evaluation.seed if picture.seed is None else picture.seed, picture)
    print(shown(out))
    return 0


def play(
    path: Path,
    task: Path | None,
    overrides: Sequence[str],
    seed: int | None,
    host: str,
    port: int,
    browser: bool | None,
    trust_code: bool,
) -> int:
    """Shows a policy, or a robot without one, live in a browser."""
    check_mujoco()
    from kickbench.envs.compile import read_task
    from kickbench.training.trained import load_run
    from kickbench.view.play import play as show
    from kickbench.view.session import fitting

    run = load_run(path, trust_code=trust_code, unfinished=True) if path.is_dir() else None
    if run is None and task is not None:
        raise KickbenchError(f"--task is for a run's policy, and {shown(path)} is not a run directory")
    if run is not None and task is None and not overrides:
        compiled = run.trial.task
    else:
        compiled = read_task(task or (run.directory.task_spec if run else path), overrides)
        compiled = replace(compiled, is_trusted=run is None or task is not None or trust_code)
    show(
        compiled,
        fitting(compiled, run) if run else None,
        f"kickbench play {shown(path)}",
        seed=compiled.spec.evaluation.seed if seed is None else seed,
        host=host,
        port=port,
        browser=browser,
    )
    return 0


def plot(file: Path, out: Path, overrides: Sequence[str]) -> int:
    """Draws a task's sampling regions from above."""
    from kickbench.config.load import load_task
    from kickbench.config.yamlio import load_document
    from kickbench.envs.catalog import model_of_task
    from kickbench.envs.compile import compile_task
    from kickbench.trials.validate import kind_of
    from kickbench.view.regions import plot_regions

    kind = kind_of(load_document(file))
    if kind != "task":
        raise KickbenchError(f"--plot draws the sampling regions of a task; {file} is a {kind} file")
    plot_regions(compile_task(load_task(model_of_task, file, overrides)), out)
    print(shown(out))
    return 0


def _render_of(out: Path | None, picture: Picture) -> Callable[..., None]:
    """What the suffix of the output asks for.

    Raises:
        KickbenchError: Another suffix, or an option that the suffix has no use for.
    """
    suffix = out.suffix.lower() if out else ".png"
    if suffix == ".png":
        _refuse(picture, "a .png shows starts", "policy", "episodes", "mirrored")
        return _sheet
    if suffix in (".webp", ".mp4"):
        _refuse(picture, f"a {suffix} shows episodes", "starts")
        return _film
    raise KickbenchError(f"{out}: pictures are .png, .webp or .mp4")


def _refuse(picture: Picture, reason: str, *options: str) -> None:
    for option in options:
        if getattr(picture, option) is not None:
            raise KickbenchError(f"--{option}: {reason}")


def _sheet(task: CompiledTask, out: Path, seed: int, picture: Picture) -> None:
    from kickbench.results.atomic import atomic_file
    from kickbench.view.pictures import contact_sheet

    sheet = contact_sheet(task, picture.starts or _STARTS, seed, *(picture.size or _SHEET_SIZE))
    with atomic_file(out) as file:
        sheet.save(file, "PNG")


def _film(task: CompiledTask, out: Path, seed: int, picture: Picture) -> None:
    from kickbench.view.pictures import film_runs

    size, episodes = picture.size or _FILM_SIZE, picture.episodes or _EPISODES
    film_runs(task, picture.policy or [], out, episodes, seed, size, mirrored=bool(picture.mirrored))
