"""Verbs that look at results: `table`, `compare`, `claims` and `report`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from kickbench.cli import app as cli
from kickbench.config.shipped import names
from kickbench.errors import KickbenchError, shown

if TYPE_CHECKING:
    import pandas as pd

    from kickbench.trials.experiment import LoadedExperiment

_CLAIMED = "Folder of its runs (default: the shipped; of an experiment of your own: runs/<experiment>)."


@cli.verb("Look at results", "table runs --columns kick")
def table(
    roots: cli.Roots,
    columns: Literal["success", "kick"] = cli.option("Figures (default: success).", default="success"),
) -> None:
    """Print the table of finished runs."""
    from kickbench.results.tables import render_table

    print(render_table(_runs(roots), columns))


@cli.verb("Look at results", "compare runs")
def compare(roots: cli.Roots) -> None:
    """Compare methods over their seeds."""
    from kickbench.results.compare import render_comparison

    print(render_comparison(_runs(roots)))


@cli.verb("Look at results", "claims mini_home_field runs/mini_home_field")
def claims(
    experiment: cli.Experiment,
    folder: Path | None = cli.argument(_CLAIMED, "DIR", default=None),
    strict: bool = cli.flag("Exit code 1 unless every claim is met.", "--strict"),
    json: cli.Json = False,
) -> int:
    """Judge the claims of an experiment by its measured runs; exit code 1 if there are none."""
    from kickbench.results.frame import load_runs
    from kickbench.results.tables import left_out_lines
    from kickbench.results.verdicts import judge, verdict_lines, verdicts_json
    from kickbench.trials.experiment import load_experiment

    loaded = load_experiment(experiment)
    # A missing default folder means that nothing is measured yet; a folder that the user names must exist.
    if folder and not folder.is_dir():
        raise KickbenchError(f"{folder}: no such folder")
    kept = loaded.document.file.parent.parent / "measured" / loaded.name
    is_own = loaded.document.file not in names("experiment").values()
    folder = folder or (Path("runs", loaded.name) if is_own and not kept.is_dir() else kept)
    measured = load_runs(folder, loaded)
    verdicts = judge(loaded, measured)
    heading, *rest = verdict_lines(loaded, verdicts)
    lines = (f"{heading}, by the runs in {shown(folder)}", *rest)
    print(verdicts_json(verdicts) if json else "\n".join(lines))
    for line in [*_when_fixed(loaded, measured), *left_out_lines(measured[measured.condition.isna()])]:
        print(line, file=sys.stderr if json else sys.stdout)
    if (measured.state == "missing").all():
        print(f"no run in {shown(folder)}", file=sys.stderr)
        return 1
    return int(strict and any(verdict.outcome != "met" for verdict in verdicts))


def _when_fixed(experiment: LoadedExperiment, measured: pd.DataFrame) -> list[str]:
    """How many of the runs that count were begun with the claims that they are judged by."""
    from kickbench.results.frame import runs_of

    runs = runs_of(measured)
    records = [origin.experiment for origin in runs.provenance[runs.counted]]
    kinds = ("with these claims", "with other claims", "without a record of claims")
    found = [kinds[2 if r is None else int(r.claims != experiment.claims_hash)] for r in records]
    said = ", ".join(f"{found.count(kind)} {kind}" for kind in kinds if kind in found)
    return [f"{len(records)} runs, begun {said}"] if records else []


@cli.verb("Look at results", "report runs/mini_home_field --experiment mini_home_field")
def report(
    folder: Path | None = cli.argument("A run directory, or a folder of them.", "DIR", default=None),
    out: Path | None = cli.option("Page to write (default: DIR/report.html).", "-o", "--out", metavar="FILE"),
    experiment: cli.For = None,
    readme: bool = cli.flag("Write README.md's results from results/measured instead.", "--readme"),
    root: Path = typer.Option(Path(), hidden=True),
) -> None:
    """Write one self-contained page about a folder of runs, or the README's results."""
    if readme:
        if folder or out or experiment:
            raise KickbenchError("--readme takes results/measured and README.md: no DIR, -o or --experiment")
        from kickbench.report.readme import write_readme

        print("\n".join(map(str, write_readme(root))))
        return
    if folder is None:
        raise KickbenchError("expected a folder of runs: kickbench report DIR, or kickbench report --readme")
    from kickbench.report.page import write_report
    from kickbench.trials.experiment import load_experiment

    out = out or folder / "report.html"
    write_report(folder, out, load_experiment(experiment) if experiment else None)
    print(shown(out))


def _runs(roots: list[Path]) -> pd.DataFrame:
    """The runs of some folders, each once however many of the folders it is in.

    Raises:
        KickbenchError: A folder has no finished run: its name may be misspelt. Says what is there instead.
    """
    from kickbench.results.frame import load_runs
    from kickbench.results.tables import left_out_lines

    runs = load_runs(roots)
    finished = [path.resolve() for path in runs.path[runs.state == "finished"]]
    empty = [str(root) for root in roots if not any(path.is_relative_to(root.resolve()) for path in finished)]
    if empty:
        raise KickbenchError("\n".join([*left_out_lines(runs), f"no finished run in {', '.join(empty)}"]))
    return runs
