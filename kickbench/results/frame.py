"""All runs of a folder as one table, which is what every verb that shows results reads.

A row per run and side of its evaluation. A run without a result (unfinished, running, damaged, or planned and
missing) has one row without figures, so that nothing is left out in silence; so has a damaged result on a
transfer task.

| columns | content |
|---|---|
| `path`, `condition`, `task`, `method`, `seed` | the run; `condition` is None where no experiment plans it |
| `side`, `evaluated_on` | which episodes, of which task: `task` itself or a transfer task |
| `identity`, `setting` | fingerprints of the run, and of only its task, robot and model; None where unknown |
| `recipe` | fingerprint of the run without the policy that it began with |
| `evaluated_setting` | fingerprint of a transfer task, its robot and model; None where unknown |
| `iterations`, `iterations_planned`, `scale` | training iterations done and wanted |
| `state` | finished, unfinished, running, missing or damaged |
| `problem` | why there is no result, it does not count, or is smaller than planned: a sentence or None |
| `setting_name`, `group` | what a finished run is compared within, and averaged within |
| `counted` | whether the row belongs in a mean |
| `success_rate`, `success_low`, ... | the figures of `EvaluationMetrics`; an interval is `_low` and `_high` |
| `termination/<name>`, `non_finite`, `kicks/...` | shares of episodes, counts of kicks |
| `equivariance/relative`, `pairs/agreement`, ... | the figures of `Asymmetry`, the same on both sides |
| `env_steps`, `training_seconds`, ... `provenance` | of the run; `provenance` is a record |

Runs are compared within a *setting*: one task, robot and model. Runs of a setting are averaged within a
*group*: one identity, number of iterations and scale, whatever their files are called; the policies that they
began with may be of several seeds. Settings and groups that share a name are numbered, `baseline (1)` and
`baseline (2)`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import pandas as pd
from pydantic import BaseModel

from kickbench.config.experiment import POINT, Side
from kickbench.config.load import load_method
from kickbench.errors import KickbenchError, shown
from kickbench.results.episode_table import NON_FINITE, SIDES
from kickbench.results.identity import Identity, read_identity, setting_of
from kickbench.results.integrity import check
from kickbench.results.metrics import Asymmetry, EvaluationMetrics, Metrics, load_metrics
from kickbench.results.progress_table import read_done
from kickbench.results.store import RunDirectory, find_begun_runs

if TYPE_CHECKING:
    from kickbench.results.specs import Specs
    from kickbench.trials.experiment import Condition, LoadedExperiment

HOME: Side = "in_distribution"
MOST_NON_FINITE = 0.01
"""Share of a run's episodes that may become non-finite (NaN or infinite) before nothing is concluded from
it."""

Row = dict[str, Any]

_TEXT = (
    *("path", "condition", "task", "method", "side", "evaluated_on", "identity", "setting", "recipe"),
    "evaluated_setting",
    *("state", "problem", "provenance", "twins", "equivariance/but_for"),
)
_NUMBERS = (
    *("iterations", "iterations_planned", "scale", "env_steps", "training_seconds", "schedule_iterations"),
    "non_finite",
)
_OF_THE_POLICY = ("method", "seed", "env_steps")
_DISTANCES = tuple(f"{name}_distance{end}" for name in ("mean", "median") for end in ("", "_low", "_high"))


def load_runs(root: Path | str | Sequence[Path], experiment: LoadedExperiment | None = None) -> pd.DataFrame:
    """Reads all runs in a folder, finished or not.

    Args:
        root: The folder, itself a run or above some; or several, of which each run is read once.
        experiment: What the folder should hold, as `<condition>/seed<k>`. Its runs come first, in its order,
            with those that are missing; a run counts only if its identity is that of the planned task and
            method.

    Returns:
        The table that the module describes. A file that cannot be read is a `problem`, not an error.

    Raises:
        SpecError: A task and a method of the experiment do not fit together.
    """
    roots = [Path(root)] if isinstance(root, str | Path) else list(root)
    conditions = experiment.conditions.values() if experiment else ()
    rows = [row for folder in roots for condition in conditions for row in _planned_rows(folder, condition)]
    planned = {row["path"].resolve() for row in rows}
    found: dict[Path, RunDirectory] = {}
    for run in (run for folder in roots for run in find_begun_runs(folder)):
        found.setdefault(run.path.resolve(), run)
    unplanned = {"problem": f"not planned by {experiment.name}", "counted": False} if experiment else {}
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
    return None if pd.isna(value) else value


def _table(rows: Sequence[Row]) -> pd.DataFrame:
    """Rows as a table with every column, None in texts and NaN in numbers where there is nothing."""
    rows = [{**row, "problem": _problem(row)} for row in rows]
    figures = {**_flat(EvaluationMetrics), **_flat(Asymmetry)}
    names = dict.fromkeys([*_TEXT, "seed", "counted", *_NUMBERS, *figures, *(n for row in rows for n in row)])
    frame = pd.DataFrame({name: [row.get(name) for row in rows] for name in names}, dtype=object)
    numbers = [name for name in names if name not in (*_TEXT, "seed", "counted")]
    frame = frame.astype(dict.fromkeys(numbers, float) | {"counted": bool, "seed": "Int64"})
    # A termination that ended no episode is not in a result's table.
    shares = [name for name in numbers if name.startswith("termination/")]
    frame[shares] = frame[shares].where(frame.episodes.isna(), frame[shares].fillna(0.0))
    return frame.copy()  # pandas warns of a table whose columns lie apart


def _problem(row: Row) -> str | None:
    """How far a run without a result is, or what a reader must know of its result beside what is known."""
    state, done, planned = row["state"], row["iterations"], row.get("iterations_planned")
    if state == "finished":
        scaled = [f"scaled to {row['scale']:g}"] if row["scale"] else []
        smaller = [f"{done:,} of {planned:,} iterations"] if planned not in (None, done) else []
        return ", ".join([*scaled, *smaller, *filter(None, [row.get("problem")])]) or None
    if row.get("problem") or state == "missing" or done is None:
        return str(row.get("problem") or state)
    return f"{state}: {done:,}{'' if planned is None else f' of {planned:,}'} iterations"


def _flat(model: type[BaseModel], values: Mapping[str, Any] | None = None, prefix: str = "") -> Row:
    """Figures of a model as columns: `a: {b: 1}` is `a/b`, `x_ci: (0, 1)` is `x_low` and `x_high`.

    What there is no value of is None.
    """
    flat: Row = {}
    for name, info in model.model_fields.items():
        value = (values or {}).get(name)
        kinds = (info.annotation, *get_args(info.annotation))
        inner = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)
        if inner is not None:
            flat |= _flat(inner, value, f"{prefix}{name}/")
        elif name == "terminations":
            flat |= {f"termination/{ending}": share for ending, share in (value or {}).items()}
        elif name.endswith("_ci"):
            low, high = value or (None, None)
            flat |= {f"{prefix}{name[:-3]}_low": low, f"{prefix}{name[:-3]}_high": high}
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def _result_rows(metrics: Metrics) -> list[Row]:
    """A row per side of a result."""
    evaluation = metrics.evaluation.model_dump(include={*SIDES, "asymmetry"})
    own = {
        **metrics.model_dump(exclude={"schema_version", "evaluation", "provenance"}),
        **_flat(Asymmetry, evaluation["asymmetry"]),
        "evaluated_on": metrics.task,
        "provenance": metrics.provenance,
        "state": "finished",
        "counted": True,
    }
    rows = [{**own, "side": side, **_side_figures(evaluation[side])} for side in SIDES if evaluation[side]]
    lost = max(row["non_finite"] for row in rows)
    words = f"{100 * lost:.1f} % of its episodes became non-finite" if lost > MOST_NON_FINITE else None
    return [row | {"problem": words} for row in rows]


def _side_figures(side: Mapping[str, Any]) -> Row:
    """The figures of a side; distances of episodes that all became non-finite mean nothing."""
    non_finite = side["terminations"].get(NON_FINITE, 0.0)
    return (
        _flat(EvaluationMetrics, side)
        | (dict.fromkeys(_DISTANCES) if non_finite == 1 else {})
        | {"non_finite": non_finite}
    )


def _rows(directory: RunDirectory) -> list[Row]:
    """The rows of one run: a single one without figures if it has no result that can be trusted."""
    is_running = directory.is_occupied
    is_finished = directory.metrics.exists() and not is_running
    row: Row = {
        **_named_by_place(directory.path),
        "path": directory.path,
        "side": HOME,
        "counted": False,
        "iterations": read_done(directory.progress),
        "iterations_planned": _stored_iterations(directory),
        "state": "running" if is_running else "unfinished" if directory.holds_a_run else "missing",
    }
    try:
        if not is_running:
            check(directory.path)
        with suppress(*() if is_finished else [KickbenchError]):  # what has only begun may have none
            row |= _identity_columns(directory)
        if not is_finished:
            return [row]
        metrics = load_metrics(directory.metrics)
    except KickbenchError as error:
        return [row | _damaged(directory, error)]
    rows = [{**row, **figures} for figures in _result_rows(metrics)]
    return [*rows, *_transfer_rows(directory, rows[0])]


def _damaged(directory: RunDirectory, error: KickbenchError) -> Row:
    words = str(error).replace(f"{directory.path}/", "").replace(f"{shown(directory.path)}/", "")
    return {"side": HOME, "state": "damaged", "problem": f"damaged ({words})", "counted": False}


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
    identity = read_identity(directory.path)
    return {"identity": identity.fingerprint, "setting": identity.setting, "recipe": identity.recipe}


def _transfer_rows(directory: RunDirectory, own: Row) -> Iterator[Row]:
    """Results of the run's policy on tasks that it was not trained on."""
    keep = ("path", "task", "method", "seed", "identity", "setting", "recipe")
    keep += ("iterations", "iterations_planned")
    for path in sorted(directory.also("x").parent.glob("*.json")):
        row = {name: own[name] for name in keep} | {"evaluated_on": path.stem}
        try:
            yield from ({**figures, **row} for figures in _result_rows(load_metrics(path)))
        except KickbenchError as error:
            yield row | _damaged(directory, error)


def _planned_rows(root: Path, condition: Condition) -> Iterator[Row]:
    """The rows of the planned runs of a condition, which is compiled only if there is a run of it."""
    planned, setting = cache(partial(_planned_specs, condition)), cache(partial(_transfer_setting, condition))
    iterations = condition.method.spec.algorithm.iterations
    for seed in condition.seeds:
        first, *_ = rows = _rows(RunDirectory(run_path(root, condition.name, seed)))
        own: Row = {"condition": condition.name, "seed": seed, "iterations_planned": iterations}
        if first["state"] != "finished":
            task, method = condition.task.name, condition.method.name
            yield first | own | {"task": task, "evaluated_on": task, "method": method}
            continue
        is_planned = _is_of(first, condition, planned().identity)
        unequal = [] if first["seed"] == seed else [f"its seed is {first['seed']}"]
        is_counted = is_planned and not unequal
        unequal += [] if is_planned else _differences(RunDirectory(first["path"]), planned())
        for row in rows:
            name, found = row["evaluated_on"], row.get("evaluated_setting")
            is_old = found is not None and name in condition.transfer and found != setting(name)
            changed = [f"the task {name} has changed since the evaluation"] if is_old else []
            own["problem"] = ", ".join(filter(None, [row["problem"], *unequal, *changed]))
            yield row | own | {"counted": row["counted"] and is_counted and not is_old}


def _planned_specs(condition: Condition) -> Specs:
    from kickbench.results.specs import specs_of
    from kickbench.trials.trial import load_trial

    task, method = condition.task.document.file, condition.method.document.file
    return specs_of(load_trial(task, method, condition.settings))


def _transfer_setting(condition: Condition, name: str) -> str:
    from kickbench.envs.compiled_task import compile_task

    return setting_of(compile_task(condition.transfer[name]))


def _is_of(row: Row, condition: Condition, planned: Identity) -> bool:
    """Whether a run has the planned identity, and began with the policy of the planned run."""
    source, initial = condition.init_from, row["provenance"].initial
    if source is None:
        return row["identity"] == planned.fingerprint
    of = source if isinstance(source, Path) else run_path(row["path"].parents[1], source, row["seed"])
    with suppress(KickbenchError):
        parts = dict(read_identity(row["path"]).parts)
        if initial is not None and parts.pop("initial_policy", None) is not None:
            begun = load_metrics(RunDirectory(of).metrics)
            same_run = all(getattr(initial, key) == getattr(begun, key) for key in _OF_THE_POLICY)
            start = read_identity(of).fingerprint, condition.init_std
            return same_run and start == (initial.fingerprint, initial.std) and parts == planned.parts
    return False


def _differences(directory: RunDirectory, planned: Specs) -> list[str]:
    """In what the specs of a run of another identity differ from those of the plan."""
    from kickbench.results.specs import differences, stored_specs

    try:
        found = stored_specs(directory)
    except KickbenchError:
        return ["another identity"]
    return differences([found, planned], "{0[0]} (planned {0[1]})".format) or ["another identity"]


def _with_repeats(frame: pd.DataFrame) -> pd.DataFrame:
    """Marks runs of an identity and seed that an earlier row has: of both, that one counts.

    An experiment may plan one identity as two conditions, of which each has its runs.
    """
    found = frame[(frame.state == "finished") & (frame.condition.isna() | frame.counted)]
    key = ["condition", "identity", "iterations", "scale", "seed"]
    first = found.groupby(key, dropna=False, sort=False).path.transform("first")
    repeats = first[first != found.path].map(shown)
    frame.loc[repeats.index, "problem"] = "of the same identity and seed as " + repeats
    frame.loc[repeats.index, "counted"] = False
    return frame


def _with_groups(frame: pd.DataFrame) -> pd.DataFrame:
    """Names the settings and groups of finished runs, without namesakes."""
    finished = frame[frame.state == "finished"]
    settings = finished.setting.fillna(finished.task)
    recipes = _recipes(finished).fillna(finished.task + "/" + finished.method)
    groups = recipes + " " + finished.iterations.astype(str) + " " + finished.scale.fillna(1.0).astype(str)
    # A point of a sweep is called as its folder is: it differs from the others in what the name says.
    folders = pd.Series([path.parent.name for path in finished.path], finished.index, dtype=object)
    methods = finished.method.where(~folders.str.contains(POINT, regex=False), folders)
    names = {
        "setting_name": _numbered(finished.task, settings, pd.Series("", finished.index)),
        "group": _numbered(methods, groups, settings),
    }
    return frame.assign(**{name: labels.reindex(frame.index) for name, labels in names.items()})


def _recipes(finished: pd.DataFrame) -> pd.Series:
    """What runs share that differ only in seeds: their own, and those of the runs that they began with."""
    rows = zip(finished.identity, finished.recipe, finished.provenance, strict=True)
    known: dict[str, Any] = {identity: (recipe, origin.initial) for identity, recipe, origin in rows}

    def whole(identity: str) -> str:
        recipe, initial = known.get(identity, (identity, None))
        return recipe if initial is None else f"{recipe} {whole(initial.fingerprint)} {initial.std}"

    return finished.identity.map(whole, na_action="ignore")


def _numbered(names: pd.Series, keys: pd.Series, wholes: pd.Series) -> pd.Series:
    """The first name of each key, numbered where several keys of one whole share it."""
    first = pd.DataFrame({"name": names, "key": keys, "whole": wholes}, dtype=object)
    first = first.drop_duplicates("key").set_index("key")
    namesakes = first.groupby(["whole", "name"])["name"]
    numbers, counts = (namesakes.cumcount() + 1).astype(str), namesakes.transform("size")
    labels = first["name"].where(counts == 1, first["name"] + " (" + numbers + ")")
    return keys.map(labels).astype(object)
