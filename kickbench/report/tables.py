"""The tables of a page, as frames of text: the page and the READMEs print the same cells."""

from __future__ import annotations

import pandas as pd

from kickbench.report.remarks import remarks
from kickbench.report.study import SIDE_WORDS, Study
from kickbench.results.frame import HOME, known
from kickbench.results.provenance import Provenance
from kickbench.results.quantities import DISTANCE, SUCCESS, Quantity


def comparison(study: Study) -> pd.DataFrame:
    """Reported beside measured, a row per condition and side; what was reported only if something was."""
    found = {quantity: study.estimates(quantity) for quantity in (SUCCESS, DISTANCE)}
    rows = found[SUCCESS]
    table = pd.DataFrame({"Method": rows.condition, "Episodes": rows.side.map(SIDE_WORDS)})
    told = any(of.reported.notna().any() for of in found.values())
    for quantity, estimates in found.items():
        own = rows[["condition", "side"]].merge(estimates, "left")
        if told:
            table[f"{quantity.heading}, reported"] = [
                _reported(study, row, quantity) for _, row in own.iterrows()
            ]
        name = f"{quantity.heading}, measured" if told else quantity.heading
        table[name] = [quantity.of_seeds(row) for _, row in own.iterrows()]
    return table


def _reported(study: Study, estimate: pd.Series, quantity: Quantity) -> str:
    """A reported figure with its section."""
    if pd.isna(estimate.reported):
        return "not reported"
    reported = study.plans[estimate.condition].reported
    section = reported.section if reported else ""
    return f"{quantity.spread(estimate.reported, estimate.reported_std)}{f' ({section})' if section else ''}"


def iterations_text(study: Study, run: pd.Series) -> str:
    """`390`, or `45 of 390` where the experiment plans another number."""
    planned = study.plans[run.condition].iterations if run.condition in study.plans else run.iterations
    return f"{run.iterations:,.0f}" + (f" of {planned:,}" if planned != run.iterations else "")


def every_run(study: Study) -> pd.DataFrame:
    """Every run, finished or not, with its intervals and what a reader must know of it."""
    rows = []
    for _, run in study.runs.iterrows():
        own = study.rows[(study.rows.path == run.path) & (study.rows.evaluated_on == run.task)]
        done, seconds = known(run, "iterations"), known(run, "training_seconds")
        words = "-" if done is None else f"{done:,.0f} iterations"
        rows.append(
            {
                **_sides(run, own),
                "Training": words if seconds is None else f"{words} ({hours(seconds)})",
                "Remarks": "; ".join(remarks(study, run)) or ("as planned" if study.plans else "none"),
            }
        )
    return pd.DataFrame(rows)


def further(study: Study) -> pd.DataFrame:
    """Results of the same policies on tasks that they were not trained on; the index is the condition."""
    found = study.rows[(study.rows.evaluated_on != study.rows.task) & (study.rows.state == "finished")]
    rows, conditions = [], []
    for (_, task), sides in found.groupby(["path", "evaluated_on"], sort=False):
        run = sides.iloc[0]
        conditions.append(run.condition)
        rows.append({"Run": run_name(run), "Task": str(task), **_sides(run, sides)})
    return pd.DataFrame(rows, conditions)


def _sides(run: pd.Series, sides: pd.DataFrame) -> dict[str, str]:
    """Success on both sides, and the distance."""
    by_side = {row.side: row for _, row in sides.iterrows()}
    return {
        "Run": run_name(run),
        "Success in distribution [%]": SUCCESS.of_run(by_side.get(HOME)),
        "Success mirrored [%]": SUCCESS.of_run(by_side.get("mirrored")),
        "Distance [m]": DISTANCE.of_run(by_side.get(HOME)),
    }


def by_run(study: Study, quantities: tuple[Quantity, ...]) -> pd.DataFrame:
    """Figures of finished runs; empty if no run has any of them."""
    runs = study.runs[study.runs.state == "finished"]
    table = pd.DataFrame({of.heading: [of.of_run(run) for _, run in runs.iterrows()] for of in quantities})
    table.insert(0, "Run", [run_name(run) for _, run in runs.iterrows()])
    return table[(table[[of.heading for of in quantities]] != "not measured").any(axis=1)]


def provenance(study: Study) -> pd.DataFrame:
    """Code, hardware and versions of every finished run, what it took, and the command that made it."""
    runs = study.runs[study.runs.state == "finished"]
    return pd.DataFrame(
        {
            "Run": run_name(run),
            "Commit": commit_text(of),
            "Hardware": f"{hardware(of)} ({of.platform})",
            "Versions": ", ".join(f"{name} {version}" for name, version in of.versions.items()),
            "Time": hours(of.seconds)
            + (f" (in {len(of.resumed_from) + 1} parts)" if of.resumed_from else ""),
            "Steps": f"{of.env_steps:,}",
            "Finished": of.finished[:10],
            "Command": " ".join(of.command),
        }
        for (_, run), of in zip(runs.iterrows(), runs.provenance, strict=True)
    )


def run_name(run: pd.Series) -> str:
    """Condition and seed."""
    return f"{run.condition} (seed {'?' if run.seed is pd.NA else run.seed})"


def hours(seconds: float) -> str:
    """A time in hours, or in minutes below one."""
    return f"{seconds / 3600:.1f} h" if seconds >= 3600 else f"{seconds / 60:.1f} min"


def hardware(provenance: Provenance) -> str:
    """Device and threads."""
    threads = "1 thread" if provenance.num_threads == 1 else f"{provenance.num_threads} threads"
    return f"{provenance.device}, {threads}"


def commit_text(provenance: Provenance) -> str:
    """The commit in short."""
    return (provenance.commit or "unknown")[:10] + (" + changes" if provenance.dirty else "")


def first_touches(runs: pd.DataFrame) -> pd.DataFrame:
    """Numbers of first touches by side of the ball and foot, both sides of each evaluation together."""
    names = runs.study + ": " + runs.condition + ", seed " + runs.seed.astype(str)
    feet = {"left foot": "left_foot", "no foot": "other", "right foot": "right_foot", "never": "none"}
    touches = {
        f"ball {side}, {name}": runs[f"kicks/ball_{side}/{column}"]
        for side in ("left", "right")
        for name, column in feet.items()
    }
    return pd.DataFrame(touches).groupby(names, sort=False).sum().astype(int)


def words(table: pd.DataFrame) -> str:
    """A table in a line: `baseline: in distribution 48.4, mirrored 20.2; ...`, the index first."""
    rows = (
        f"{name}: {', '.join(f'{column} {value}' for column, value in row.items())}"
        for name, row in table.iterrows()
    )
    return "; ".join(rows)
