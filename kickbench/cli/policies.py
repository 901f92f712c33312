"""Verbs for policies: `eval`, `render`, `play` and `export`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kickbench.cli import app as cli
from kickbench.config.shipped import find
from kickbench.errors import KickbenchError, shown

_PLAYED = "Run directory; or a task, for zero action."
_SHEET_STATES, _EPISODES = 9, 3
_SHEET_SIZE, _FILM_SIZE = (400, 300), (640, 480)


@cli.verb("Train", "eval runs/mini_home_field/equivariant/seed1 --episodes 500", name="eval")
def evaluate(
    run: cli.Run,
    task: Path | None = cli.option("Another task: file or name (default: the run's).", **cli.TASK),
    grid: bool = cli.flag("On a goal grid: every ball position with every target.", "--grid"),
    save: bool = cli.flag("Keep what --task or --grid gives in RUN/also/<task>[_grid].json.", "--save"),
    episodes: int | None = cli.count("Episodes a side (default: the task's), of a grid: a place (1)."),
    seed: cli.TaskSeed = None,
    json: cli.Json = False,
    threads: cli.Threads = None,
    trust_code: cli.Trust = False,
) -> None:
    """Evaluate the policy of a finished run again."""
    if save and not (task or grid):
        raise KickbenchError("--save keeps other figures beside the run's own: it needs --task or --grid")
    from kickbench.launch.run import evaluate_again
    from kickbench.results.frame import frame_of
    from kickbench.results.tables import render_grid, render_table
    from kickbench.training.trained import load_run

    loaded = load_run(run, task, trust_code=trust_code)
    # Where a run keeps its task, the file's name is not the task's.
    name = loaded.trial.task.name if task else loaded.metrics.task
    name += "_grid" if grid else ""
    size = {"episodes": episodes, "seed": seed, "threads": threads}
    metrics = evaluate_again(loaded, name, save=save, grid=grid, **size)
    if json:
        print(metrics.model_dump_json(indent=2))
    elif (grid_rates := metrics.evaluation.grid) is not None:
        count = metrics.evaluation.in_distribution.episodes
        print(render_grid(f"goal grid: {name}: {count} episodes on {len(grid_rates)} targets", grid_rates))
    else:
        print(render_table(frame_of([metrics])))


@cli.verb("Look at results", "render mini_home_field --out sheet.png")
def render(
    task: cli.Task,
    policy: list[Path] = cli.option("Runs, side by side (default: zero action).", metavar="RUN", default=[]),
    out: Path | None = cli.option("Sheet of initial states (.png) or film (.webp).", metavar="FILE"),
    initial_states: int | None = cli.count("Initial states on a sheet (default: 9)."),
    episodes: int | None = cli.count("Episodes of a film (default: 3)."),
    seed: cli.TaskSeed = None,
    size: cli.Size = None,
    mirrored: bool = cli.flag("Film the mirror images of the initial states.", "--mirrored"),
    overrides: cli.Set = cli.NONE,
) -> None:
    """Draw initial states of a task, or film episodes."""
    from kickbench.view.backend import check_mujoco

    check_mujoco()
    suffix = out.suffix.lower() if out else ".png"
    if suffix not in (".png", ".webp"):
        raise KickbenchError(f"{out}: pictures are .png or .webp")
    if suffix == ".png" and (policy or episodes or mirrored):
        raise KickbenchError("a .png shows initial states: no --policy, --episodes or --mirrored")
    if suffix == ".webp" and initial_states:
        raise KickbenchError("a .webp shows episodes: no --initial-states")
    from kickbench.envs.compiled_task import read_task
    from kickbench.results.atomic import atomic_file
    from kickbench.view.pictures import contact_sheet, film_runs

    compiled = read_task(task, overrides)
    out = out or Path(f"{compiled.name}.png")
    seed = compiled.spec.evaluation.seed if seed is None else seed
    if suffix == ".png":
        sheet = contact_sheet(compiled, initial_states or _SHEET_STATES, seed, *(size or _SHEET_SIZE))
        with atomic_file(out) as picture:
            sheet.save(picture, "PNG")
    else:
        film_runs(compiled, policy, out, episodes or _EPISODES, seed, size or _FILM_SIZE, mirrored=mirrored)
    print(shown(out))


@cli.verb("Look at results", "play runs/mini_home_field/equivariant/seed0")
def play(
    path: Path = cli.argument(_PLAYED, "RUN|TASK", autocompletion=cli.names_of("task")),
    task: Path | None = cli.option("Another task for the run's policy.", **cli.TASK),
    seed: cli.TaskSeed = None,
    port: int = cli.option("Port, or the next free (default: 8080).", default=8080, min=0, max=2**16 - 1),
    host: str = cli.option("Interface; who reaches it controls the page.", default="127.0.0.1"),
    browser: bool | None = cli.option("Open a browser (default: if there is one).", "--browser/--no-browser"),
    trust_code: cli.Trust = False,
    overrides: cli.Set = cli.NONE,
) -> None:
    """Show a policy live in a browser."""
    path = path if path.is_dir() else find(path, "task")
    from kickbench.view.backend import check_mujoco

    check_mujoco()
    from kickbench.envs.compiled_task import read_task
    from kickbench.training.trained import load_run
    from kickbench.view.play import play as show
    from kickbench.view.session import Session

    run = load_run(path, trust_code=trust_code, unfinished=True) if path.is_dir() else None
    if run is None and task is not None:
        raise KickbenchError(f"--task is for a run's policy, and {shown(path)} is not a run directory")
    if run is not None and task is None and not overrides:
        compiled = run.trial.task
    else:
        compiled = read_task(task or (run.directory.task_spec if run else path), overrides)
        compiled = replace(compiled, is_trusted=run is None or task is not None or trust_code)
    policy, protocol = run.policy_for(compiled) if run else None, compiled.spec.evaluation
    seed, title = protocol.seed if seed is None else seed, f"kickbench play {shown(path)}"
    show(Session(compiled, policy, seed, protocol.episodes, title), host, port, browser)


@cli.verb("Look at results", "export runs/mini_home_field/equivariant/seed0")
def export(
    run: cli.Run,
    out: Path | None = cli.option("Folder to write (default: below exported).", "-o", "--out", metavar="DIR"),
    states: int = cli.count("Write so many initial states of the evaluation, too.", least=0, default=0),
    force: bool = cli.flag("Overwrite a policy that is there.", "--force"),
) -> None:
    """Write a run's policy as ONNX, with a contract of inputs, outputs, gains and limits."""
    from kickbench.deploy.export import export as write

    print(shown(write(run, out, states=states, force=force)))
