"""What a page says: its tables, as frames of text, and its caveats, in sentences.

The caveats are what a reader must know before believing the tables.

The page and the READMEs print the same cells.
"""

from __future__ import annotations

from typing import Any, get_args

import pandas as pd

from kickbench.report.study import SIDE_WORDS, Study
from kickbench.results.frame import HOME, known, size_differences, unfinished_words
from kickbench.results.provenance import Provenance
from kickbench.results.quantities import DISTANCE, SUCCESS, Quantity, non_finite_note
from kickbench.results.verdicts import Outcome, Verdict


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


def outcome(study: Study) -> list[str]:
    """How many claims are met, and the success of every condition."""
    words = {"not enough data": "without enough data to say"}
    counts = {word: sum(verdict.outcome == word for verdict in study.verdicts) for word in get_args(Outcome)}
    said = ", ".join(f"{count} {words.get(word, word)}" for word, count in counts.items() if count)
    found = [f"Of {len(study.verdicts)} claims: {said}."] if study.verdicts else []
    estimates = study.estimates(SUCCESS)
    for condition, sides in estimates[estimates.seeds > 0].groupby("condition", sort=False):
        rates = (f"{SUCCESS.of_seeds(row)} {SIDE_WORDS[row.side]}" for _, row in sides.iterrows())
        found.append(f"{condition}: success in % {', '.join(rates)}.")
    return found


def verdict_words(verdict: Verdict) -> str:
    """The verdict, and whether the experiment could have decided it."""
    return verdict.words if verdict.claim.decidable else f"{verdict.words} (three seeds cannot decide it)"


def evidence(verdict: Verdict) -> str:
    """`measured 28.2 [15.3, 41.2] points (5 seeds); reported 30.1 points`."""
    unit, figure = verdict.unit, "not measured"
    if verdict.figure is not None:
        figure = f"measured {unit.write(verdict.figure, verdict.interval)} ({verdict.basis})"
    return figure if verdict.reported is None else f"{figure}; reported {unit.write(verdict.reported)}"


def warnings(study: Study, commit: str | None = None) -> list[str]:
    """What is unfinished, smaller, other than planned or of other code: each remark once, with its runs."""
    finished = int((study.runs.state == "finished").sum())
    found = [] if finished == len(study.runs) else [f"{finished} of {len(study.runs)} runs are finished."]
    about: dict[str, list[Any]] = {}
    for index, run in study.runs.iterrows():
        for remark in remarks(study, run, commit):
            about.setdefault(remark, []).append(index)
    said = (f"{remark[0].upper()}{remark[1:]}: {listed(study.runs.loc[of])}." for remark, of in about.items())
    return [*found, *said]


def remarks(study: Study, run: pd.Series, commit: str | None = None) -> list[str]:
    """In which respects a run is unfinished, smaller or other than planned, or by other code.

    Args:
        study: The study.
        run: The row of the run.
        commit: Commit of the present code; None: do not compare.
    """
    if run.state == "missing":
        return ["not run"]
    if run.state == "damaged":
        return [f"damaged, and not shown ({run.damage})"]
    if run.state != "finished":
        return [f"{unfinished_words(run)}, not evaluated", *filter(None, [run.deviation])]
    planned, ran = known(run, "iterations_planned"), known(run, "schedule_iterations")
    smaller = [] if study.plans else size_differences(run, iterations=planned)
    made_by = run.provenance.commit or "unknown"
    found = [
        (run.deviation is not None, str(run.deviation)),
        (run.repeats is not None, "of the same identity and seed as another run, counted once"),
        (not run.counted and run.repeats is None, "not counted"),
        (commit not in (None, made_by), f"run by other code than this page's, commit {made_by[:10]}"),
        (run.provenance.dirty, "run by code with uncommitted changes"),
        (ran is not None, f"its schedules ran over {ran or 0:,.0f} iterations"),
    ]
    rows = study.rows[(study.rows.path == run.path) & (study.rows.evaluated_on == run.task)]
    lost = (
        f"episodes {SIDE_WORDS[of.side]}:{non_finite_note(of.non_finite)}"
        for _, of in rows[rows.non_finite > 0].iterrows()
    )
    return [*smaller, *(words for holds, words in found if holds), *lost]


def listed(runs: pd.DataFrame) -> str:
    """Runs by condition and seed: `baseline seeds 0 and 1, equivariant seed 0`."""
    parts = []
    for condition, of in runs.groupby("condition", sort=False):
        *most, last = ("?" if seed is pd.NA else str(seed) for seed in of.seed)
        parts.append(
            f"{condition} seeds {', '.join(most)} and {last}" if most else f"{condition} seed {last}"
        )
    return ", ".join(parts)
