"""All runs of a folder as one table, which is what every verb that shows results reads.

A row per run and side of its evaluation. A run without a result (unfinished, running, damaged, or planned and
missing) has one row without figures, so that nothing is left out in silence; so has a damaged result on a
transfer task.

| columns | content |
|---|---|
| `path`, `condition`, `task`, `method`, `seed` | the run; `condition` is None where no experiment plans it |
| `side`, `evaluated_on` | which episodes, of which task: `task` itself or a transfer task |
| `identity`, `setting` | fingerprints of the run, and of only its task, robot and model; None where unknown |
| `iterations`, `iterations_planned`, `scale` | training iterations done and wanted |
| `state`, `damage`, `deviation` | finished, unfinished, running, missing or damaged; sentences or None |
| `repeats` | path of another run of the same identity and seed, which is the one that counts |
| `setting_name`, `group` | what a finished run is compared within, and averaged within |
| `counted` | whether the row belongs in a mean |
| `success_rate`, `success_low`, ... | the figures of `EvaluationMetrics`; an interval is `_low` and `_high` |
| `termination/<name>`, `non_finite`, `kicks/...` | shares of episodes, counts of kicks |
| `equivariance/relative`, `pairs/agreement`, ... | the figures of `Asymmetry`, the same on both sides |
| `env_steps`, `training_seconds`, ... `provenance` | of the run; `provenance` is a record |

Runs are compared within a *setting*: one task, robot and model. Runs of a setting are averaged within a
*group*: one identity, number of iterations and scale, whatever their files are called. Settings and groups
that share a name are numbered, `baseline (1)` and `baseline (2)`.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import pandas as pd
from pydantic import BaseModel

from kickbench.config.experiment import POINT, Side
from kickbench.config.load import load_method
from kickbench.errors import KickbenchError, shown
from kickbench.results.episode_table import NON_FINITE
from kickbench.results.identity import read_identity
from kickbench.results.integrity import check
from kickbench.results.metrics import Asymmetry, EvaluationMetrics, Metrics, load_metrics
from kickbench.results.progress_table import read_done
from kickbench.results.store import RunDirectory, find_begun_runs

if TYPE_CHECKING:
    from kickbench.results.specs import Specs
    from kickbench.trials.experiment import Condition, LoadedExperiment

SIDES: tuple[Side, ...] = get_args(Side)
HOME: Side = "in_distribution"

Row = dict[str, Any]

_TEXT = (
    *("path", "condition", "task", "method", "side", "evaluated_on", "identity", "setting"),
    *("state", "damage", "deviation", "repeats", "provenance", "twins", "equivariance/but_for"),
)
_NUMBERS = (
    *("iterations", "iterations_planned", "scale", "env_steps", "training_seconds", "schedule_iterations"),
    "non_finite",
)
_OF_THE_SETTING = ("task", "robot", "model", "terms")
_DISTANCES = tuple(f"{name}_distance{end}" for name in ("mean", "median") for end in ("", "_low", "_high"))


def load_runs(root: Path | str | Sequence[Path], experiment: LoadedExperiment | None = None) -> pd.DataFrame:
    """Reads all runs in a folder, finished or not.

    Args:
        root: The folder, itself a run or above some; or several, of which each run is read once.
        experiment: What the folder should hold, as `<condition>/seed<k>`. Its runs come first, in its order,
            with those that are missing; a run counts only if its identity is that of the planned task and
            method.

    Returns:
        The table that the module describes. A file that cannot be read is a `damage`, not an error.

    Raises:
        SpecError: A task and a method of the experiment do not fit together.
    """
    roots = [Path(root)] if isinstance(root, str | Path) else list(root)
    rows = [row for folder in roots for row in _planned_rows(folder, experiment)] if experiment else []
    planned = {row["path"].resolve() for row in rows}
    found: dict[Path, RunDirectory] = {}
    for run in (run for folder in roots for run in find_begun_runs(folder)):
        found.setdefault(run.path.resolve(), run)
    unplanned = {"deviation": f"not planned by {experiment.name}", "counted": False} if experiment else {}
    others = (run for path, run in found.items() if path not in planned)
    rows += [row | unplanned for run in others for row in _rows(run)]
    return _with_groups(_with_repeats(_table(rows)))


def frame_of(results: Iterable[Metrics]) -> pd.DataFrame:
    """The table of results that are in no folder; their `path` is `<task>/<method>/seed<k>`."""
    rows = [
        {**row, "path": Path(metrics.task, metrics.method, f"seed{metrics.seed}")}
        for metrics in results
        for row in _result_rows(metrics)
    ]
    return _with_groups(_table(rows))


def runs_of(frame: pd.DataFrame) -> pd.DataFrame:
    """One row per run: that of its own task in distribution."""
    return frame[(frame.side == HOME) & (frame.evaluated_on == frame.task)]


def run_path(folder: Path, condition: str, seed: int) -> Path:
    """Where an experiment has the run of a condition with a seed."""
    return Path(folder) / condition / f"seed{seed}"


def known(row: pd.Series, name: str) -> Any:
    """A value of a row; None if there is none."""
    value = row.get(name)
    return (
        None if value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value)) else value
    )


def unfinished_words(row: pd.Series) -> str:
    """How far a run without a result is, or why its result does not count."""
    if row.state == "damaged":
        return str(row.damage)
    done, planned = known(row, "iterations"), known(row, "iterations_planned")
    if row.state == "missing" or done is None:
        return str(row.state)
    return f"{row.state}: {done:,.0f}{'' if planned is None else f' of {planned:,.0f}'} iterations"


def _table(rows: Sequence[Row]) -> pd.DataFrame:
    """Rows as a table with every column, None in texts and NaN in numbers where there is nothing."""
    own = [*_TEXT, "seed", "counted", *_NUMBERS, *_columns(EvaluationMetrics), *_columns(Asymmetry)]
    others = dict.fromkeys(name for row in rows for name in row if name not in own)
    frame = pd.DataFrame({name: [row.get(name) for row in rows] for name in (*own, *others)}, dtype=object)
    numbers = [name for name in frame if name not in (*_TEXT, "counted", "seed")]
    shares = [name for name in others if str(name).startswith("termination/")]
    frame = frame.astype(dict.fromkeys(numbers, float) | {"counted": bool, "seed": "Int64"})
    # A termination that ended no episode is not in a result's table.
    frame[shares] = frame[shares].where(frame.episodes.isna(), frame[shares].fillna(0.0))
    return frame


def _columns(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """The columns that `_flat` makes of a model."""
    for name, info in model.model_fields.items():
        kinds = (info.annotation, *get_args(info.annotation))
        inner = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)
        if inner is not None:
            yield from _columns(inner, f"{prefix}{name}/")
        elif name != "terminations":
            yield from _flat({name: None}, prefix)


def _flat(values: Mapping[str, Any], prefix: str = "") -> Row:
    """Nested figures as columns: `a: {b: 1}` is `a/b`, and `x_ci: (0, 1)` is `x_low` and `x_high`."""
    flat: Row = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{name.replace('terminations', 'termination')}/")
        elif name.endswith("_ci"):
            low, high = value or (None, None)
            flat |= {f"{prefix}{name[:-3]}_low": low, f"{prefix}{name[:-3]}_high": high}
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def _result_rows(metrics: Metrics) -> list[Row]:
    """A row a side of a result."""
    evaluation = metrics.evaluation
    own = {
        **metrics.model_dump(exclude={"schema_version", "evaluation", "provenance"}),
        **(_flat(evaluation.asymmetry.model_dump(exclude_none=True)) if evaluation.asymmetry else {}),
        "evaluated_on": metrics.task,
        "provenance": metrics.provenance,
        "state": "finished",
        "counted": True,
    }
    sides = {side: getattr(evaluation, side) for side in SIDES}
    return [{**own, "side": side, **_side_figures(of)} for side, of in sides.items() if of is not None]


def _side_figures(side: EvaluationMetrics) -> Row:
    """The figures of a side; distances of episodes that all became non-finite mean nothing."""
    figures = _flat(side.model_dump())
    figures["non_finite"] = side.terminations.get(NON_FINITE, 0.0)
    return figures | (dict.fromkeys(_DISTANCES) if figures["non_finite"] == 1 else {})


def _rows(directory: RunDirectory) -> list[Row]:
    """The rows of one run."""
    row, metrics = _read(directory)
    if metrics is None:
        return [row]
    rows = [{**row, **figures} for figures in _result_rows(metrics)]
    return [*rows, *_transfer_rows(directory, rows[0], metrics)]


def _read(directory: RunDirectory) -> tuple[Row, Metrics | None]:
    """What every row of a run says, and its result if there is one that can be trusted."""
    row = _named_by_place(directory.path) | {"path": directory.path, "side": HOME, "counted": False}
    row |= {"iterations_planned": _stored_iterations(directory), "iterations": read_done(directory.progress)}
    is_occupied = directory.is_occupied
    is_finished = directory.metrics.exists() and not is_occupied
    if not is_finished:
        begun = "unfinished" if directory.holds_a_run else "missing"
        row["state"] = "running" if is_occupied else begun
        with suppress(KickbenchError):  # what has only begun may have none
            row |= _identity_columns(directory)
    try:
        if not is_occupied:
            check(directory.path)
        if is_finished:
            return row | _identity_columns(directory), load_metrics(directory.metrics)
    except KickbenchError as error:
        row |= _damaged(directory, error)
    return row, None


def _damaged(directory: RunDirectory, error: KickbenchError) -> Row:
    words = str(error).replace(f"{directory.path}/", "").replace(f"{shown(directory.path)}/", "")
    return {"side": HOME, "state": "damaged", "damage": words, "counted": False}


def _named_by_place(path: Path) -> Row:
    """A run without a result is named by its place, `<task>/<method>/seed<k>`: nothing in it says more."""
    *_, task, method, own = ("", "", *path.resolve().parts)
    number = re.fullmatch(r"seed(\d+)", own)
    return {"task": task, "evaluated_on": task, "method": method, "seed": int(number[1]) if number else None}


def _stored_iterations(directory: RunDirectory) -> int | None:
    try:
        return load_method(directory.method_spec).spec.algorithm.iterations
    except KickbenchError:
        return None


def _identity_columns(directory: RunDirectory) -> Row:
    """Fingerprints of the run, and of all but the method: what runs must share to be compared."""
    identity = read_identity(directory.path)
    setting = "".join(identity.parts.get(name, "") for name in _OF_THE_SETTING)
    return {"identity": identity.fingerprint, "setting": hashlib.sha256(setting.encode()).hexdigest()}


def _transfer_rows(directory: RunDirectory, own: Row, metrics: Metrics) -> Iterator[Row]:
    """Results of the run's policy on tasks that it was not trained on."""
    keep = ("path", "task", "method", "seed", "identity", "setting", "iterations", "iterations_planned")
    for path in sorted(directory.also("x").parent.glob("*.json")):
        row = {name: own[name] for name in keep} | {"evaluated_on": path.stem}
        try:
            result = load_metrics(path)
            for key, expected in {"task": path.stem, "method": metrics.method, "seed": metrics.seed}.items():
                if (found := getattr(result, key)) != expected:
                    raise KickbenchError(f"{path}: expected the {key} {expected}, found {found}")
            yield from ({**figures, **row} for figures in _result_rows(result))
        except KickbenchError as error:
            yield row | _damaged(directory, error)


def _planned_rows(root: Path, experiment: LoadedExperiment) -> Iterator[Row]:
    """The rows of every planned run, compared with the plan."""
    for condition in experiment.conditions.values():
        planned = _Planned(condition)
        for seed in condition.seeds:
            rows = _rows(RunDirectory(run_path(root, condition.name, seed)))
            found, trained = rows[0]["seed"], {"condition": condition.name, "seed": seed}
            trained["iterations_planned"] = condition.iterations
            if rows[0]["state"] != "finished":
                task = condition.task.name
                trained |= {"task": task, "evaluated_on": task, "method": condition.method.name}
            elif words := planned.deviation(rows[0], found, seed):
                trained["deviation"] = words
            for row in rows:
                row |= trained
                if row["state"] == "finished":
                    row["counted"] = found == seed and planned.is_of(row)
                yield row


class _Planned:
    """A condition as planned; it is compiled only if there is a run to compare with it."""

    def __init__(self, condition: Condition) -> None:
        self._condition = condition

    @cached_property
    def specs(self) -> Specs:
        """Its specs and its identity."""
        from kickbench.results.specs import specs_of
        from kickbench.trials.trial import load_trial

        task, method = self._condition.task.document.file, self._condition.method.document.file
        return specs_of(load_trial(task, method, self._condition.overrides))

    def is_of(self, row: Row) -> bool:
        """Whether a run has the planned identity, and began with the policy of the planned run."""
        source, path = self._condition.init_from, Path(row["path"])
        if source is None:
            return row["identity"] == self.specs.identity.fingerprint
        with suppress(KickbenchError):
            parts, initial = dict(read_identity(path).parts), row["provenance"].initial
            of = source if isinstance(source, Path) else run_path(path.parents[1], source, row["seed"])
            if initial is None or parts.pop("initial_policy", None) is None:
                return False
            same = initial.std == self._condition.init_std
            same &= initial.fingerprint == read_identity(of).fingerprint
            return same and parts == self.specs.identity.parts
        return False

    def deviation(self, row: Row, seed: int, planned_seed: int) -> str | None:
        """In what a finished run differs from the plan, in words; None: in nothing."""
        parts = [] if seed == planned_seed else [f"its seed is {seed}"]
        parts += size_differences(
            row, iterations=self._condition.iterations, episodes=self._condition.episodes
        )
        if not self.is_of(row):
            parts += self._differences(RunDirectory(row["path"]))
        return ", ".join(parts) or None

    def _differences(self, directory: RunDirectory) -> list[str]:
        """In what the specs of a run of another identity differ; the number of episodes is named apart."""
        from kickbench.results.specs import EPISODES, differences, stored_specs

        try:
            found = stored_specs(directory)
        except KickbenchError:
            return ["another identity"]
        return differences([found, self.specs], "{0[0]} (planned {0[1]})".format, without=(EPISODES,))


def size_differences(run: Mapping[str, Any] | pd.Series, **planned: float | None) -> list[str]:
    """In what size a finished run differs from a plan: `scaled to 0.1`, `45 of 390 iterations`.

    Args:
        run: A row of the table, or what one is made of.
        planned: Size by column, such as `iterations` or `episodes`; None: not known.
    """
    scale = run["scale"]
    smaller = [f"scaled to {scale:g}"] if scale and scale > 0 else []
    unequal = {name: size for name, size in planned.items() if size not in (None, run[name])}
    return [*smaller, *(f"{run[name]:,.0f} of {size:,.0f} {name}" for name, size in unequal.items())]


def _with_repeats(frame: pd.DataFrame) -> pd.DataFrame:
    """Marks runs of an identity and seed that an earlier row has: of both, that one counts."""
    runs = runs_of(frame)
    runs = runs[(runs.state == "finished") & (runs.condition.isna() | runs.counted)]
    same = runs.groupby(["identity", "iterations", "scale", "seed"], dropna=False, sort=False)
    first = dict(zip(runs.path, same.path.transform("first"), strict=True))
    earlier = [first[path] if first.get(path, path) != path else None for path in frame.path]
    frame["repeats"] = pd.Series(earlier, frame.index, dtype=object)
    frame["counted"] &= frame.repeats.isna()
    return frame


def _with_groups(frame: pd.DataFrame) -> pd.DataFrame:
    """Names the settings and groups of finished runs, without namesakes."""
    finished = frame[frame.state == "finished"]
    rows = [row for _, row in finished.iterrows()]
    settings = [row.setting or row.task for row in rows]
    groups = [
        f"{row.identity or f'{row.task}/{row.method}'} {known(row, 'iterations')} {known(row, 'scale')}"
        for row in rows
    ]
    # A point of a sweep is called as its folder is: it differs from the others in what the name says.
    folders = [Path(row.path).parent.name for row in rows]
    methods = [folder if POINT in folder else row.method for folder, row in zip(folders, rows, strict=True)]
    names = {
        "setting_name": _numbered(finished.task, settings, [""] * len(rows)),
        "group": _numbered(pd.Series(methods, finished.index), groups, settings),
    }
    return frame.assign(**{name: labels.reindex(frame.index) for name, labels in names.items()})


def _numbered(names: pd.Series, keys: Sequence[str], wholes: Sequence[str]) -> pd.Series:
    """The first name of each key, numbered where several keys of one whole share it."""
    first = pd.DataFrame({"name": list(names), "key": keys, "whole": wholes}, dtype=object)
    first = first.drop_duplicates("key").set_index("key")
    namesakes = first.groupby(["whole", "name"])["name"]
    numbers, counts = (namesakes.cumcount() + 1).astype(str), namesakes.transform("size")
    labels = first["name"].where(counts == 1, first["name"] + " (" + numbers + ")")
    return pd.Series([labels[key] for key in keys], names.index, dtype=object)
