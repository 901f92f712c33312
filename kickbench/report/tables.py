"""The tables of a page, as cells of text: what was reported beside what was measured, run by run, and provenance."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from kickbench.config.experiment import Side
from kickbench.report.remarks import listed, remarks
from kickbench.report.spread import (
    DISTANCE,
    MEASURES,
    SUCCESS,
    Measure,
    Reported,
    ReportedFigures,
    Spread,
    interval_of,
    spreads,
)
from kickbench.report.study import SIDE_WORDS, Study
from kickbench.results.columns import non_finite_note
from kickbench.results.frame import HOME, known
from kickbench.results.provenance import Provenance
from kickbench.results.statistics import Interval

NOT_MEASURED, NOT_REPORTED = "not measured", "not reported"


@dataclass(frozen=True)
class Cell:
    """A cell.

    Attributes:
        text: What it says.
        note: What qualifies that, in small.
        faint: Whether it says that something is not there.
        whole: Whether it stays in one line.
    """

    text: str
    note: str = ""
    faint: bool = False
    whole: bool = False


@dataclass(frozen=True)
class Table:
    """A table; the first cell of a row is its heading."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def reported_of(study: Study) -> ReportedFigures:
    """What was reported of the conditions of a study, as `spreads` asks for it."""

    def find(arm: str, side: Side, measure: Measure) -> Reported | None:
        told = study.plans[arm].reported if arm in study.plans else None
        figures = told.of_side(side) if told else None
        value = getattr(figures, measure.key, None)
        return None if value is None else Reported(value, getattr(figures, f"{measure.key}_std", None))

    return find


def comparison_table(study: Study) -> Table:
    """Reported beside measured, a row a condition and side; what was reported only if something was."""
    reported = reported_of(study)
    by_measure = {of: spreads(study.rows, study.conditions, of, reported) for of in MEASURES}
    told = any(spread.reported for found in by_measure.values() for spread in found)
    columns = ["Method", "Episodes"]
    for measure in MEASURES:
        title = f"{measure.short} [{measure.unit}]"
        columns += [f"{title}, reported", f"{title}, measured"] if told else [title]
    rows = []
    for first in by_measure[SUCCESS]:
        cells = [Cell(first.arm), Cell(SIDE_WORDS[first.side], whole=True)]
        for measure in MEASURES:
            spread = next(
                (of for of in by_measure[measure] if (of.arm, of.side) == (first.arm, first.side)), None
            )
            cells += [reported_cell(spread, measure, study)] if told else []
            cells.append(measured_cell(spread, measure))
        cells.append(_effort_cell(study, first.arm))
        rows.append(tuple(cells))
    return Table("Success and distance by method", (*columns, "Training"), tuple(rows))


def reported_cell(spread: Spread | None, measure: Measure, study: Study) -> Cell:
    """A reported figure with its section."""
    if spread is None or spread.reported is None:
        return Cell(NOT_REPORTED, faint=True)
    std = "" if spread.reported.std is None else f" ± {measure.text(spread.reported.std)}"
    told = study.plans[spread.arm].reported
    return Cell(f"{measure.text(spread.reported.value)}{std}", told.section if told else "")


def measured_cell(spread: Spread | None, measure: Measure) -> Cell:
    """A measured figure with its interval: mean ± standard deviation over seeds, or a single seed's."""
    if spread is None or spread.mean is None:
        return Cell(NOT_MEASURED, faint=True)
    lost = non_finite_note(spread.non_finite)
    if spread.std is None:
        note = f"95 % {_interval(spread.seeds[0].interval, measure)}, 1 seed{lost}"
        return Cell(measure.text(spread.mean), note)
    text = f"{measure.text(spread.mean)} ± {measure.text(spread.std)}"
    interval = spread.interval
    seeds = f"{len(spread.seeds)} seeds{lost}"
    return Cell(text, f"95 % {_interval(interval, measure)}, {seeds}" if interval else "")


def runs_table(study: Study) -> Table:
    """Every run, finished or not, with its intervals and what a reader must know of it."""
    columns = (
        "Run",
        "Success in distribution [%]",
        "Success mirrored [%]",
        "Distance [m]",
        "Training",
        "Remarks",
    )
    rows = tuple(_run_row(study, run) for _, run in study.runs.iterrows())
    return Table("Every run, with 95 % intervals over its episodes", columns, rows)


def asymmetry_table(study: Study) -> Table | None:
    """How differently policies treat left and right, a row a run; None if no run tells."""
    columns = (
        "Run", "Equivariance error [%]", "Kicks with the foot on the ball's side [%]", "Kicks with the left foot [%]",
        "Success, ball left [%]", "Success, ball right [%]", "Mirrored pairs alike [%]",
    )  # fmt: skip
    finished = study.runs[study.runs.state == "finished"]
    rows = tuple(_asymmetry_row(run) for _, run in finished.iterrows())
    told = finished["legs/kicks"].notna().any()
    return Table("Left and right, a row a run", columns, rows) if told else None


def kick_table(study: Study) -> Table | None:
    """Launch of the ball and what came before and after it, a row a run; None if no run has the figures."""
    columns = (
        "Run", "Launch [m/s]", "Direction error [rad]", "Its bias [rad]", "First touch after [s]", "Touches",
        "Walked after it [m]", "Falls [%]", "Not finite [%]",
    )  # fmt: skip
    runs = [run for _, run in study.runs.iterrows() if known(run, "kick/falls") is not None]
    return (
        Table("The kick in distribution, a row a run", columns, tuple(map(_kick_row, runs))) if runs else None
    )


def further_rows(study: Study) -> list[tuple[str, tuple[Cell, ...]]]:
    """Condition and cells of each result on a transfer task."""
    rows = study.rows[(study.rows.evaluated_on != study.rows.task) & (study.rows.state == "finished")]
    found = []
    for (_, task), of in rows.groupby(["path", "evaluated_on"], sort=False):
        sides = {row.side: row for _, row in of.iterrows()}
        home, mirrored = sides[HOME], sides.get("mirrored")
        cells = (_name(home), Cell(str(task)), _success(home), _success(mirrored), _distance(home))
        found.append((str(home.condition), cells))
    return found


def further_table(study: Study) -> Table | None:
    """Results of the same policies on further tasks, a row a run and task; None if there are none."""
    rows = tuple(cells for _, cells in further_rows(study))
    columns = ("Run", "Task", "Success in distribution [%]", "Success mirrored [%]", "Distance [m]")
    return Table("The same policies on tasks they were not trained on", columns, rows) if rows else None


def origins_table(study: Study) -> Table:
    """Code, hardware and versions, a row for all runs that share them."""
    groups: dict[tuple[Cell, ...], dict[str, list[int]]] = {}
    for _, run in study.runs[study.runs.state == "finished"].iterrows():
        groups.setdefault(_origin(run.provenance), {}).setdefault(run.condition, []).append(run.seed)
    rows = tuple((Cell(listed(arms)), *cells) for cells, arms in groups.items())
    return Table("Code and hardware", ("Runs", "Commit", "Hardware", "Versions"), rows)


def provenance_table(study: Study) -> Table:
    """What every finished run took, and the command that made it."""
    columns = ("Run", "Time", "Steps", "Finished", "Command")
    finished = study.runs[study.runs.state == "finished"]
    rows = tuple(_provenance_row(run, run.provenance) for _, run in finished.iterrows())
    return Table("Finished runs", columns, rows)


def hours(seconds: float) -> str:
    """A time in hours, or in minutes below one."""
    return f"{seconds / 3600:.1f} h" if seconds >= 3600 else f"{seconds / 60:.1f} min"


def hardware(provenance: Provenance) -> str:
    """Device, and threads where physics ran on them."""
    threads = "1 thread" if provenance.num_threads == 1 else f"{provenance.num_threads} threads"
    return f"{provenance.device}, {threads}"


def commit_text(provenance: Provenance) -> str:
    """The commit in short."""
    return (provenance.commit or "unknown")[:10] + (" + changes" if provenance.dirty else "")


def effort(study: Study, arm: str) -> str:
    """Training iterations of a condition's runs, planned ones beside them where they differ."""
    done = sorted({int(count) for count in study.counted(arm).iterations})
    if not done:
        return "none finished"
    text = f"{done[0]:,}" if len(done) == 1 else f"{done[0]:,} to {done[-1]:,}"
    planned = study.plans[arm].iterations if arm in study.plans else None
    return f"{text} of {planned:,} iterations" if planned not in (None, *done) else f"{text} iterations"


def _effort_cell(study: Study, arm: str) -> Cell:
    counted, whole = len(study.counted(arm)), int((study.runs.condition == arm).sum())
    finished = int(((study.runs.condition == arm) & (study.runs.state == "finished")).sum())
    note = f"{finished} of {whole} runs finished" if finished < whole else ""
    other = f"{finished - counted} not counted" if counted < finished else ""
    return Cell(effort(study, arm), ", ".join(filter(None, (note, other))), faint=not counted)


def _run_row(study: Study, run: pd.Series) -> tuple[Cell, ...]:
    own = study.rows[(study.rows.path == run.path) & (study.rows.evaluated_on == run.task)]
    sides = {row.side: row for _, row in own.iterrows()}
    done, seconds = known(run, "iterations"), known(run, "training_seconds")
    words = "-" if done is None else f"{done:,.0f} iterations"
    training = Cell(words, "" if seconds is None else hours(seconds), faint=done is None)
    said = "; ".join(remarks(study, run)) or ("as planned" if study.plans else "none")
    return (_name(run), _success(run), _success(sides.get("mirrored")), _distance(run), training, Cell(said))


def _name(run: pd.Series) -> Cell:
    return Cell(run.condition, "seed ?" if run.seed is pd.NA else f"seed {run.seed}")


def _success(row: pd.Series | None) -> Cell:
    return _figure(row, SUCCESS)


def _distance(row: pd.Series) -> Cell:
    return _figure(row, DISTANCE)


def _figure(row: pd.Series | None, measure: Measure) -> Cell:
    value = None if row is None else known(row, measure.key)
    if row is None or value is None:
        return Cell(NOT_MEASURED, faint=True)
    note = f"{_interval(interval_of(row, measure), measure)}{non_finite_note(row.non_finite)}"
    return Cell(measure.text(value), note)


def _asymmetry_row(run: pd.Series) -> tuple[Cell, ...]:
    return (
        _name(run),
        _percent(run, "equivariance/relative", digits=3),
        _percent(run, "legs/same_side_share", "legs/same_side"),
        _percent(run, "legs/left_foot_share", "legs/left_foot"),
        _percent(run, "success/left_rate"),
        _percent(run, "success/right_rate"),
        _percent(run, "pairs/agreement", "pairs/agreement"),
    )


def _kick_row(run: pd.Series) -> tuple[Cell, ...]:
    median = known(run, "kick/median_direction_error")
    return (
        _name(run),
        _kick_figure(run, "mean_launch_speed"),
        _kick_figure(run, "mean_direction_error", note="" if median is None else f"median {median:.2f}"),
        *(_kick_figure(run, name) for name in ("direction_bias", "mean_time_to_touch", "mean_touches")),
        _kick_figure(run, "mean_walked_after_touch"),
        _percent(run, "kick/falls"),
        _percent(run, "kick/non_finite"),
    )


def _kick_figure(run: pd.Series, name: str, note: str = "") -> Cell:
    value, low, high = (known(run, f"kick/{name}{end}") for end in ("", "_low", "_high"))
    if value is None:
        return Cell(NOT_MEASURED, faint=True)
    return Cell(f"{value:z.2f}", note if low is None else f"[{low:.2f}, {high:.2f}]")


def _percent(run: pd.Series, name: str, ends: str = "", digits: int = 1) -> Cell:
    value, low = known(run, name), known(run, f"{ends}_low")
    if value is None:
        return Cell(NOT_MEASURED, faint=True)
    text = f"{100 * value:.{digits}f}" if digits == 1 else f"{100 * value:.{digits}g}"
    return Cell(text, "" if low is None else _interval(Interval(low, run[f"{ends}_high"]), SUCCESS))


def _interval(interval: Interval, measure: Measure) -> str:
    return f"[{measure.text(interval.low)}, {measure.text(interval.high)}]"


def _origin(provenance: Provenance) -> tuple[Cell, ...]:
    versions = ", ".join(f"{name} {version}" for name, version in provenance.versions.items())
    return (
        Cell(commit_text(provenance), whole=True),
        Cell(hardware(provenance), provenance.platform),
        Cell(versions),
    )


def _provenance_row(run: pd.Series, provenance: Provenance) -> tuple[Cell, ...]:
    parts = f"in {len(provenance.resumed_from) + 1} parts" if provenance.resumed_from else ""
    return (
        _name(run),
        Cell(hours(provenance.seconds), parts, whole=True),
        Cell(f"{provenance.env_steps:,}", whole=True),
        Cell(provenance.finished[:10], whole=True),
        Cell(" ".join(provenance.command)),
    )
