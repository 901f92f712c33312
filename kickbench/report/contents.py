"""What a page says: its tables, as frames of text, and its caveats, in sentences.

The caveats are what a reader must know before believing the tables.

The page and the READMEs print the same cells.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, get_args

import pandas as pd

from kickbench.report.study import SIDE_WORDS, Study
from kickbench.results.episode_table import SIDES
from kickbench.results.frame import HOME
from kickbench.results.provenance import Provenance
from kickbench.results.quantities import DISTANCE, SUCCESS, Quantity
from kickbench.results.verdicts import Outcome, Verdict


def comparison(study: Study) -> pd.DataFrame:
    """Reported beside measured, a row per condition and side; what was reported only if something was."""
    found = {quantity: study.estimates(quantity) for quantity in (SUCCESS, DISTANCE)}
    rows = found[SUCCESS]
    table = pd.DataFrame({"Method": rows.condition, "Episodes": rows.side.map(SIDE_WORDS)})
    has_reported = any(of.reported.notna().any() for of in found.values())
    for quantity, estimates in found.items():
        own = [row for _, row in rows[["condition", "side"]].merge(estimates, "left").iterrows()]
        if has_reported:
            table[f"{quantity.heading}, reported"] = [_reported(study, row, quantity) for row in own]
        name = f"{quantity.heading}, measured" if has_reported else quantity.heading
        table[name] = [quantity.of_seeds(row) for row in own]
    return table


def _reported(study: Study, estimate: pd.Series, quantity: Quantity) -> str:
    """A reported figure with its section."""
    if pd.isna(estimate.reported):
        return "not reported"
    section = getattr(study.plans[estimate.condition].reported, "section", "")
    return f"{quantity.spread(estimate.reported, estimate.reported_std)} ({section})"


def further(study: Study) -> pd.DataFrame:
    """Results of the same policies on tasks that they were not trained on."""
    found = study.rows[(study.rows.evaluated_on != study.rows.task) & (study.rows.state == "finished")]
    rows = []
    for _, sides in found.groupby(["path", "evaluated_on"], sort=False):
        of = {row.side: row for _, row in sides.iterrows()}
        success = {f"Success {SIDE_WORDS[side]} [%]": SUCCESS.of_run(of.get(side)) for side in SIDES}
        distance = DISTANCE.of_run(of.get(HOME))
        rows.append(
            {"Run": run_name(of[HOME]), "Task": of[HOME].evaluated_on, **success, "Distance [m]": distance}
        )
    return pd.DataFrame(rows)


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


def outcome(study: Study) -> str:
    """How many claims are met; empty without claims."""
    words = {"not enough data": "without enough data to say"}
    counts = Counter(verdict.outcome for verdict in study.verdicts)
    said = ", ".join(f"{counts[of]} {words.get(of, of)}" for of in get_args(Outcome) if counts[of])
    return f"Of {len(study.verdicts)} claims: {said}." if study.verdicts else ""


def verdict_words(verdict: Verdict) -> str:
    """The verdict, and whether the experiment could have decided it."""
    return verdict.words if verdict.claim.decidable else f"{verdict.words} (its seeds cannot decide it)"


def evidence(verdict: Verdict) -> str:
    """`measured 28.2 [15.3, 41.2] points (5 seeds); reported 30.1 points`."""
    figure = "not measured" if verdict.figure is None else f"measured {verdict.measured} ({verdict.basis})"
    return (
        figure if verdict.reported is None else f"{figure}; reported {verdict.unit.write(verdict.reported)}"
    )


def warnings(study: Study, commit: str | None = None) -> list[str]:
    """What is unfinished, smaller, other than planned or of other code: each remark once, with its runs.

    Args:
        study: The study.
        commit: Commit of the present code; None: do not compare.
    """
    finished = int((study.runs.state == "finished").sum())
    found = [] if finished == len(study.runs) else [f"{finished} of {len(study.runs)} runs are finished."]
    about: dict[str, list[Any]] = {}
    for index, run in study.runs.iterrows():
        for remark in _remarks(study, run, commit):
            about.setdefault(f"{remark[0].upper()}{remark[1:]}", []).append(index)
    found += [f"{remark}: {_listed(study.runs.loc[of])}." for remark, of in about.items()]
    notes = (file.relative_to(study.root.parent).as_posix() for file in sorted(study.root.rglob("README.md")))
    return found + [f"{note} says more of these runs." for note in notes]


def _remarks(study: Study, run: pd.Series, commit: str | None) -> list[str]:
    """In which respects a run is unfinished, smaller or other than planned, or by other code."""
    found = [run.problem] if run.problem else []
    if run.state != "finished":
        return found
    origin = run.provenance
    if commit not in (None, origin.commit):
        found.append(f"run by other code than this page's, commit {(origin.commit or 'unknown')[:10]}")
    if origin.dirty:
        found.append("run by code with uncommitted changes")
    if pd.notna(run.schedule_iterations):
        found.append(f"its schedules ran over {run.schedule_iterations:,.0f} iterations")
    for file, table in {"progress.csv": study.curves, "episodes.csv": study.episodes}.items():
        if run.counted and not (table.path == run.path).any():
            found.append(f"not in every figure, it has no {file}")
    return found


def _listed(runs: pd.DataFrame) -> str:
    """Runs by condition and seed: `baseline seeds 0 and 1, equivariant seed 0`."""
    parts = []
    for condition, of in runs.groupby("condition", sort=False):
        *most, last = of.seed.astype(object).fillna("?").map(str)
        seeds = f"seeds {', '.join(most)} and {last}" if most else f"seed {last}"
        parts.append(f"{condition} {seeds}")
    return ", ".join(parts)
