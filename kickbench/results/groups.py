"""Which runs of a table belong together: those of one identity, of one size, whatever their files are called.

Runs are compared within a *setting*: one task, robot and model. Runs of a setting are averaged within a *group*: one
identity, number of iterations and scale. Settings and groups that share a name are numbered, `baseline (1)` and
`baseline (2)`, and `differing_lines` says in what they differ.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Sequence
from pathlib import Path

import pandas as pd

from kickbench.errors import KickbenchError
from kickbench.results.frame import known
from kickbench.results.store import RunDirectory

Key = tuple[Hashable, ...]


def with_groups(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows of finished runs, with two more columns: `setting_name` and `group`, both without namesakes."""
    finished = frame[frame.state == "finished"].copy()
    settings, groups = ([key(row) for _, row in finished.iterrows()] for key in (_setting, _group))
    names = _numbered(settings, finished.task, [None] * len(settings))
    labels = _numbered(groups, finished.method, settings)
    finished["setting_name"] = pd.Series([names[key] for key in settings], finished.index, dtype=object)
    finished["group"] = pd.Series([labels[key] for key in groups], finished.index, dtype=object)
    return finished


def differing_lines(finished: pd.DataFrame) -> list[str]:
    """For settings of one task's name, and groups of one method's name, in what they differ.

    Args:
        finished: What `with_groups` has returned.
    """
    return [*setting_lines(finished), *group_lines(finished)]


def setting_lines(finished: pd.DataFrame) -> list[str]:
    """In what settings of one task's name differ."""
    lines = []
    for task, rows in finished.groupby("task", sort=False):
        lines += _lines(str(task), rows, "setting_name")
    return lines


def group_lines(finished: pd.DataFrame) -> list[str]:
    """In what groups of one setting and one method's name differ."""
    lines = []
    for (_, method), rows in finished.groupby(["setting_name", "method"], sort=False):
        lines += _lines(str(method), rows, "group")
    return lines


def _setting(row: pd.Series) -> Key:
    return (row.setting or row.task,)


def _group(row: pd.Series) -> Key:
    identity = row.identity or f"{row.task}/{row.method}"
    return (identity, known(row, "iterations"), known(row, "scale"))


def _numbered(keys: Sequence[Key], names: Iterable[str], wholes: Sequence[Key | None]) -> dict[Key, str]:
    """A label for each key: the first name it has, numbered where other keys of the same whole have it too."""
    places: dict[Key, tuple[Key | None, str]] = {}
    for key, name, whole in zip(keys, names, wholes, strict=True):
        places.setdefault(key, (whole, name))
    labels = {}
    for key, place in places.items():
        namesakes = [other for other in places if places[other] == place]
        labels[key] = place[1] + (f" ({namesakes.index(key) + 1})" if len(namesakes) > 1 else "")
    return labels


def _lines(name: str, rows: pd.DataFrame, column: str) -> Iterator[str]:
    """`baseline (1) and (2) differ: method: algorithm.gamma: 0.99 and 0.995`."""
    first = rows.drop_duplicates(column)
    if len(first) > 1:
        numbers = " and ".join(label.removeprefix(name).strip() for label in first[column])
        yield f"{name} {numbers} differ: {'; '.join([*_specs(first), *_sizes(first, column)])}"


def _specs(first: pd.DataFrame) -> list[str]:
    from kickbench.results.differences import differences, stored_specs

    if first.identity.nunique() < 2:
        return []
    try:
        return differences([stored_specs(RunDirectory(Path(path))) for path in first.path])
    except KickbenchError as error:
        return [f"specs, of which some cannot be read ({error})"]


def _sizes(first: pd.DataFrame, column: str) -> Sequence[str]:
    words = []
    if column == "group":
        if first.iterations.nunique() > 1:
            words.append(f"{' and '.join(f'{count:,.0f}' for count in first.iterations)} iterations")
        if first.scale.nunique(dropna=False) > 1:
            words.append(f"scale {' and '.join('1' if pd.isna(of) else f'{of:g}' for of in first.scale)}")
    return words
