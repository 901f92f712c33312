"""The tables of a page, as cells of text: what was reported beside what was measured, run by run, and provenance."""

from __future__ import annotations

from dataclasses import dataclass

from kickbench.report.data import SIDE_WORDS, ArmData, RunData, Side, Study
from kickbench.report.remarks import listed, remarks
from kickbench.report.spread import (
    DISTANCE,
    MEASURES,
    SUCCESS,
    Measure,
    Reported,
    ReportedFigures,
    Spread,
    spreads,
)
from kickbench.results.metrics import EvaluationMetrics
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
    """What was reported of the arms of a study, as `spreads` asks for it."""
    arms = {arm.name: arm.reported for arm in study.arms}

    def find(arm: str, side: Side, measure: Measure) -> Reported | None:
        told = arms[arm]
        figures = told.of_side(side) if told else None
        value = getattr(figures, measure.key, None)
        return None if value is None else Reported(value, getattr(figures, f"{measure.key}_std", None))

    return find


def comparison_table(study: Study) -> Table:
    """Reported beside measured, a row an arm and side; the columns of what was reported only if something was."""
    by_measure = {measure: spreads(study.arms, measure, reported_of(study)) for measure in MEASURES}
    told = any(spread.reported for found in by_measure.values() for spread in found)
    arms = {arm.name: arm for arm in study.arms}
    columns = ["Method", "Episodes"]
    for measure in MEASURES:
        title = f"{measure.short} [{measure.unit}]"
        columns += [f"{title}, reported", f"{title}, measured"] if told else [title]
    rows = []
    for index, first in enumerate(by_measure[SUCCESS]):
        cells = [Cell(first.arm), Cell(SIDE_WORDS[first.side], whole=True)]
        for measure in MEASURES:
            spread = by_measure[measure][index]
            cells += [reported_cell(spread, measure, arms[first.arm])] if told else []
            cells.append(measured_cell(spread, measure))
        cells.append(_effort_cell(arms[first.arm]))
        rows.append(tuple(cells))
    return Table("Success and distance by method", (*columns, "Training"), tuple(rows))


def reported_cell(spread: Spread, measure: Measure, arm: ArmData) -> Cell:
    """A reported figure with its section."""
    if spread.reported is None:
        return Cell(NOT_REPORTED, faint=True)
    std = "" if spread.reported.std is None else f" ± {measure.text(spread.reported.std)}"
    section = arm.reported.section if arm.reported else ""
    return Cell(f"{measure.text(spread.reported.value)}{std}", section)


def measured_cell(spread: Spread, measure: Measure) -> Cell:
    """A measured figure with its interval: mean ± standard deviation over seeds, or a single seed's."""
    if spread.mean is None:
        return Cell(NOT_MEASURED, faint=True)
    if spread.std is None:
        return Cell(measure.text(spread.mean), f"95 % {_interval(spread.seeds[0].interval, measure)}, 1 seed")
    text = f"{measure.text(spread.mean)} ± {measure.text(spread.std)}"
    interval = spread.interval
    return Cell(text, f"95 % {_interval(interval, measure)}, {len(spread.seeds)} seeds" if interval else "")


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
    rows = tuple(_run_row(run, arm) for arm in study.arms for run in arm.runs)
    return Table("Every run, with 95 % intervals over its episodes", columns, rows)


def asymmetry_table(study: Study) -> Table | None:
    """How differently policies treat left and right, a row a run; None if no run tells."""
    columns = (
        "Run", "Equivariance error [%]", "Kicks with the foot on the ball's side [%]", "Kicks with the left foot [%]",
        "Success, ball left [%]", "Success, ball right [%]", "Mirrored pairs alike [%]",
    )  # fmt: skip
    told = [run for run in study.runs if run.metrics and run.metrics.evaluation.asymmetry]
    rows = tuple(_asymmetry_row(run) for run in study.runs if run.metrics is not None)
    return Table("Left and right, a row a run", columns, rows) if told else None


def kick_table(study: Study) -> Table | None:
    """Launch of the ball and what came before and after it, a row a run; None if no run has the figures."""
    columns = (
        "Run", "Launch [m/s]", "Direction error [rad]", "Its bias [rad]", "First touch after [s]", "Touches",
        "Walked after it [m]", "Falls [%]", "Not finite [%]",
    )  # fmt: skip
    rows = tuple(_kick_row(run) for run in study.runs if run.metrics is not None)
    measured = any(run.metrics and run.metrics.evaluation.in_distribution.kick for run in study.runs)
    return Table("The kick in distribution, a row a run", columns, rows) if measured else None


def further_table(study: Study) -> Table | None:
    """Results of the same policies on further tasks, a row a run and task; None if there are none."""
    rows = []
    for run in study.runs:
        for task, metrics in run.also.items():
            home, mirrored = metrics.evaluation.in_distribution, metrics.evaluation.mirrored
            rows.append((_name(run), Cell(task), _success(home), _success(mirrored), _distance(home)))
    columns = ("Run", "Task", "Success in distribution [%]", "Success mirrored [%]", "Distance [m]")
    return (
        Table("The same policies on tasks they were not trained on", columns, tuple(rows)) if rows else None
    )


def origins_table(study: Study) -> Table:
    """Code, hardware and versions, a row for all runs that share them."""
    groups: dict[tuple[Cell, ...], dict[str, list[int]]] = {}
    for run in study.runs:
        if run.metrics is not None:
            key = _origin(run.metrics.provenance)
            groups.setdefault(key, {}).setdefault(run.arm, []).append(run.seed)
    rows = tuple((Cell(listed(arms)), *cells) for cells, arms in groups.items())
    return Table("Code and hardware", ("Runs", "Commit", "Hardware", "Versions"), rows)


def provenance_table(study: Study) -> Table:
    """What every finished run took, and the command that made it."""
    columns = ("Run", "Time", "Steps", "Finished", "Command")
    rows = tuple(
        _provenance_row(run, run.metrics.provenance) for run in study.runs if run.metrics is not None
    )
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


def effort(arm: ArmData) -> str:
    """Training iterations of an arm's finished runs, planned ones beside them where they differ."""
    done = sorted({run.metrics.iterations for run in arm.finished if run.metrics is not None})
    if not done:
        return "none finished"
    text = f"{done[0]:,}" if len(done) == 1 else f"{done[0]:,} to {done[-1]:,}"
    planned = arm.plan.iterations if arm.plan else None
    return f"{text} of {planned:,} iterations" if planned not in (None, *done) else f"{text} iterations"


def _effort_cell(arm: ArmData) -> Cell:
    finished, whole = len(arm.finished), len(arm.runs)
    note = f"{finished} of {whole} runs finished" if finished < whole else ""
    return Cell(effort(arm), note, faint=not finished)


def _run_row(run: RunData, arm: ArmData) -> tuple[Cell, ...]:
    home, mirrored, metrics = run.side("in_distribution"), run.side("mirrored"), run.metrics
    done = "-" if run.iterations is None else f"{run.iterations:,} iterations"
    training = Cell(done, hours(metrics.training_seconds) if metrics else "", faint=run.iterations is None)
    said = "; ".join(remarks(run, arm)) or ("as planned" if arm.plan else "none")
    return (_name(run), _success(home), _success(mirrored), _distance(home), training, Cell(said))


def _name(run: RunData) -> Cell:
    return Cell(run.arm, f"seed {run.seed}")


def _success(of: EvaluationMetrics | None) -> Cell:
    if of is None:
        return Cell(NOT_MEASURED, faint=True)
    return Cell(SUCCESS.text(of.success_rate), _interval(of.success_ci, SUCCESS))


def _distance(of: EvaluationMetrics | None) -> Cell:
    if of is None:
        return Cell(NOT_MEASURED, faint=True)
    return Cell(DISTANCE.text(of.mean_distance), _interval(of.mean_distance_ci, DISTANCE))


def _asymmetry_row(run: RunData) -> tuple[Cell, ...]:
    found = run.metrics.evaluation.asymmetry if run.metrics else None
    if found is None:
        return (_name(run), *[Cell(NOT_MEASURED, faint=True)] * 6)
    legs, success, pairs = found.legs, found.success, found.pairs
    return (
        _name(run),
        _percent(found.equivariance and found.equivariance.relative, None, 3),
        _percent(legs.same_side_share, legs.same_side_ci),
        _percent(legs.left_foot_share, legs.left_foot_ci),
        _percent(success and success.left_rate, None),
        _percent(success and success.right_rate, None),
        _percent(pairs and pairs.agreement, pairs and pairs.agreement_ci),
    )


def _kick_row(run: RunData) -> tuple[Cell, ...]:
    kick = run.metrics and run.metrics.evaluation.in_distribution.kick
    if not kick:
        return (_name(run), *[Cell(NOT_MEASURED, faint=True)] * 8)
    error, median = kick.mean_direction_error, kick.median_direction_error
    return (
        _name(run),
        _figure(kick.mean_launch_speed, kick.mean_launch_speed_ci),
        _figure(error, note="" if median is None else f"median {median:.2f}"),
        _figure(kick.direction_bias),
        _figure(kick.mean_time_to_touch),
        _figure(kick.mean_touches),
        _figure(kick.mean_walked_after_touch),
        _percent(kick.falls, None),
        _percent(kick.non_finite, None),
    )


def _figure(value: float | None, interval: Interval | None = None, note: str = "") -> Cell:
    if value is None:
        return Cell(NOT_MEASURED, faint=True)
    return Cell(f"{value:z.2f}", f"[{interval.low:.2f}, {interval.high:.2f}]" if interval else note)


def _percent(value: float | None, interval: Interval | None, digits: int = 1) -> Cell:
    if value is None:
        return Cell(NOT_MEASURED, faint=True)
    text = f"{100 * value:.{digits}f}" if digits == 1 else f"{100 * value:.{digits}g}"
    return Cell(text, _interval(interval, SUCCESS) if interval else "")


def _interval(interval: Interval, measure: Measure) -> str:
    return f"[{measure.text(interval.low)}, {measure.text(interval.high)}]"


def _origin(provenance: Provenance) -> tuple[Cell, ...]:
    versions = ", ".join(f"{name} {version}" for name, version in provenance.versions.items())
    return (
        Cell(commit_text(provenance), whole=True),
        Cell(hardware(provenance), provenance.platform),
        Cell(versions),
    )


def _provenance_row(run: RunData, provenance: Provenance) -> tuple[Cell, ...]:
    parts = f"in {len(provenance.resumed_from) + 1} parts" if provenance.resumed_from else ""
    return (
        _name(run),
        Cell(hours(provenance.seconds), parts, whole=True),
        Cell(f"{provenance.env_steps:,}", whole=True),
        Cell(provenance.finished[:10], whole=True),
        Cell(" ".join(provenance.command)),
    )
