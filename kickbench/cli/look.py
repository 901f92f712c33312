"""Verbs that look at results: `table`, `compare`, `claims`, `report`, `render` and `export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kickbench.cli import app as cli
from kickbench.config.shipped import find
from kickbench.errors import KickbenchError, shown

if TYPE_CHECKING:
    import pandas as pd


@cli.verb("Look at results", "table runs --columns kick")
def table(
    roots: cli.Roots,
    columns: Annotated[
        Literal["success", "kick"], cli.option("Figures to print (default: success).")
    ] = "success",
) -> int:
    """Print the table of finished runs."""
    from kickbench.results.tables import render_table

    print(render_table(_runs(roots), columns))
    return 0


@cli.verb("Look at results", "compare runs")
def compare(roots: cli.Roots) -> int:
    """Compare methods over their seeds and on the same initial states."""
    from kickbench.results.compare import render_comparison
    from kickbench.results.notes import refuse_contradictions

    runs = _runs(roots)
    refuse_contradictions(runs, shown)
    print(render_comparison(runs))
    return 0


@cli.verb("Look at results", "claims mini_home_field runs/mini_home_field")
def claims(
    experiment: cli.Experiment,
    folder: Annotated[
        Path | None,
        cli.argument(
            "Folder of its runs (default: measured/<experiment> beside the YAML file's folder).", "DIR"
        ),
    ] = None,
    strict: Annotated[bool, cli.option("Exit code 1 unless every claim is met.", "--strict")] = False,
    power: Annotated[
        bool,
        cli.option(
            "Simulate instead how often claims are met by an exact replication, and though they are wrong.",
            "--power",
        ),
    ] = False,
    json: cli.Json = False,
) -> int:
    """Judge the claims of an experiment by its measured runs."""
    file = find(experiment, "reported")
    from kickbench.cli.claims import claims

    return claims(file, folder, strict=strict, power=power, json=json)


@cli.verb("Look at results", "report runs/mini_home_field --experiment mini_home_field")
def report(
    folder: Annotated[Path | None, cli.argument("A run directory, or a folder of them.", "DIR")] = None,
    out: Annotated[
        Path | None, cli.option("Page to write (default: DIR/report.html).", "-o", "--out", metavar="FILE")
    ] = None,
    experiment: cli.For = None,
    readme: Annotated[
        bool,
        cli.option(
            "Write README.md's results and results/pictures from results/measured instead.", "--readme"
        ),
    ] = False,
    root: Annotated[Path, typer.Option(hidden=True)] = Path(),
) -> int:
    """Write one self-contained page about a folder of runs, or the README's results."""
    if readme:
        if folder or out or experiment:
            raise KickbenchError("--readme takes results/measured and README.md: no DIR, -o or --experiment")
        from kickbench.report.readme import write_readme

        print("\n".join(map(str, write_readme(root))))
        return 0
    if folder is None:
        raise KickbenchError("expected a folder of runs: kickbench report DIR, or kickbench report --readme")
    file = find(experiment, "reported") if experiment else None
    from kickbench.report.write import write_report
    from kickbench.trials.experiment import load_experiment

    out = out or folder / "report.html"
    write_report(folder, out, load_experiment(file) if file else None)
    print(shown(out))
    return 0


@cli.verb("Look at results", "render mini_home_field --out starts.png")
def render(
    task: cli.Task,
    policy: Annotated[
        list[Path],
        cli.option("Run directory (default: zero action); several are shown side by side.", metavar="RUN"),
    ] = cli.NONE,
    out: Annotated[
        Path | None,
        cli.option(
            ".png: a sheet of initial states; .webp or .mp4: episodes (default: <task>.png).", metavar="FILE"
        ),
    ] = None,
    starts: Annotated[int | None, cli.count("Initial states on a sheet (default: 9).")] = None,
    episodes: Annotated[int | None, cli.count("Episodes of a film (default: 3).")] = None,
    seed: cli.TaskSeed = None,
    size: cli.Size = None,
    mirrored: Annotated[
        bool, cli.option("Film the mirror images of the initial states.", "--mirrored")
    ] = False,
    overrides: cli.Set = cli.NONE,
) -> int:
    """Draw initial states of a task, or film episodes."""
    file = find(task, "task")
    from kickbench.cli.view import Picture, render

    return render(
        file, out, overrides, Picture(policy or None, starts, episodes, seed, size, mirrored or None)
    )


@cli.verb("Look at results", "play runs/mini_home_field/equivariant/seed0")
def play(
    path: Annotated[
        Path, cli.argument("Run directory; or a task, whose robot stands on zero action.", "RUN|TASK", "task")
    ],
    task: Annotated[Path | None, cli.option("Another task for the run's policy.", metavar="TASK")] = None,
    seed: cli.TaskSeed = None,
    port: Annotated[int, cli.count("Port, or the next that is free (default: 8080).", least=0)] = 8080,
    host: Annotated[
        str,
        cli.option("Interface; on another than the default everyone who reaches the port controls the page."),
    ] = "127.0.0.1",
    browser: Annotated[
        bool | None,
        typer.Option("--browser/--no-browser", help="Open a browser (default: where there is one)."),
    ] = None,
    trust_code: cli.Trust = False,
    overrides: cli.Set = cli.NONE,
) -> int:
    """Show a policy live in a browser."""
    if port >= 2**16:
        raise typer.BadParameter(f"--port: expected a port below 65536, found {port}")
    file = path if path.is_dir() else find(path, "task")
    from kickbench.cli.view import play as show

    return show(file, find(task, "task") if task else None, overrides, seed, host, port, browser, trust_code)


@cli.verb("Look at results", "export runs/mini_home_field/equivariant/seed0")
def export(
    run: cli.Run,
    out: Annotated[
        Path | None,
        cli.option(
            "Folder to write (default: exported/<task>/<method>/seed<k>).", "-o", "--out", metavar="DIR"
        ),
    ] = None,
    states: Annotated[int, cli.count("Write so many initial states of the evaluation, too.", least=0)] = 0,
    force: Annotated[bool, cli.option("Overwrite a policy that is there.", "--force")] = False,
) -> int:
    """Write a run's policy as ONNX, with a contract of inputs, outputs, gains and limits."""
    from kickbench.deploy.export import export as write

    print(shown(write(run, out, states=states, force=force)))
    return 0


def _runs(roots: list[Path]) -> pd.DataFrame:
    """The runs of some folders, each once however many of the folders it is in.

    Raises:
        KickbenchError: A folder has no finished run: its name may be misspelt. Says what is there instead.
    """
    from kickbench.results.frame import load_runs
    from kickbench.results.notes import left_out_lines

    runs = load_runs(roots)
    finished = [path.resolve() for path in runs.path[runs.state == "finished"]]
    empty = [
        str(root)
        for root in dict.fromkeys(roots)
        if not any(path.is_relative_to(root.resolve()) for path in finished)
    ]
    if empty:
        lines = [*left_out_lines(runs, shown), f"no finished run in {', '.join(empty)}"]
        raise KickbenchError("\n".join(lines))
    return runs
