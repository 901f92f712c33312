"""Reported figures beside ours, and the whole trainings behind ours: a run and the stages it goes on from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from kickbench.report.study import Study
from kickbench.results.progress_table import read_progress
from kickbench.results.quantities import DISTANCE, SUCCESS, Quantity
from kickbench.results.store import RunDirectory


def beside_reported(results: Sequence[Study]) -> pd.DataFrame:
    """What was reported of conditions, beside what was measured.

    Measured is the transfer task, if there is one: an experiment that trains on another task than the
    reported one is evaluated on that, too. Samples and hours are means over seeds of the whole trainings.
    """
    rows = []
    for study in (study for study in results if study.has_reported):
        for name, condition in study.plans.items():
            if condition.reported is None:
                continue
            samples, hours = _effort(study.counted(name), results)
            if condition.reported.env_steps:
                samples += f" of {condition.reported.env_steps / 1e6:,.0f}"
            for task in [*condition.transfer] or [None]:
                found = [(of, study.estimates(of, task)) for of in (SUCCESS, DISTANCE)]
                own = [(of, sides[sides.condition == name]) for of, sides in found]
                cells = [_cell(own, *columns) for columns in (("reported", "reported_std"), ("mean", "std"))]
                rows.append([task or condition.task.name, name, *cells, samples, hours])
    head = ["Task", "Method", "Thesis", "Measured", "Samples [million]", "Training [h]"]
    return pd.DataFrame(rows, columns=head)


def _cell(figures: Iterable[tuple[Quantity, pd.DataFrame]], mean: str, std: str) -> str:
    """`47.8 ± 2.1 %, 1.878 ± 0.100 m`; with an arrow to the mirrored side; a dash where nothing is known."""
    texts = []
    for of, sides in figures:
        known = sides[sides[mean].notna()]
        own = [of.spread(*pair) for pair in zip(known[mean], known[std], strict=True)]
        texts += [f"{' → '.join(own)} {of.unit.name}"] * bool(own)
    return ", ".join(texts) or "-"


def _effort(runs: pd.DataFrame, results: Sequence[Study]) -> tuple[str, str]:
    """Samples in millions and hours, or dashes without a run; `over` where an earlier stage is not known."""
    if runs.empty:
        return "-", "-"
    columns = ["env_steps", "training_seconds"]
    trainings = [stages(run, results) for _, run in runs.iterrows()]
    steps, seconds = pd.DataFrame([of[columns].astype(float).sum() for of in trainings]).mean()
    over = "over " if any(of.provenance.iloc[0].initial for of in trainings) else ""
    return f"{over}{steps / 1e6:,.0f}", f"{over}{seconds / 3600:.1f}"


def stages(run: pd.Series, results: Sequence[Study]) -> pd.DataFrame:
    """The rows of a run and of those whose policies it went on from, the first training first."""
    runs = pd.concat([study.runs[study.runs.state == "finished"] for study in results])
    others = {(other.identity, other.seed, other.env_steps): other for _, other in runs.iterrows()}
    found = [run]
    while begun := found[0].provenance.initial:
        before = others.get((begun.fingerprint, begun.seed, begun.env_steps))
        if before is None:
            break
        found.insert(0, before)
    return pd.DataFrame(found)


def whole_trainings(study: Study, results: Sequence[Study]) -> pd.DataFrame:
    """Learning curves of the conditions of which something was reported, from random networks on.

    Returns:
        Rows as of `Study.curves`, with iterations and control steps counted on from stage to stage, and the
        column way: how far a curriculum has come to the whole task, from 0 to 1.
    """
    tables = [pd.DataFrame()]
    for name, condition in study.plans.items():
        for _, run in study.counted(name).iterrows() if condition.reported else ():
            begun = pd.Series({"iteration": 0, "env_steps": 0})
            for _, stage in stages(run, results).iterrows():
                if (file := RunDirectory(stage.path).progress).exists():
                    table = read_progress(file)
                    table[begun.index] += begun
                    way = table.filter(like="curriculum/").max(axis=1)
                    way = way.fillna(float(stage.task == condition.task.name))
                    tables.append(table.assign(condition=name, seed=run.seed, path=run.path, way=way))
                begun += [stage.iterations, stage.env_steps]
    return pd.concat(tables, ignore_index=True)
