"""What one part of a page is about: rows of the table of runs, and files of runs that only a page reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd

from kickbench.config.experiment import POINT, Side
from kickbench.errors import KickbenchError
from kickbench.results.episode_table import SIDES, read_episodes
from kickbench.results.frame import HOME, load_runs, runs_of
from kickbench.results.progress_table import read_progress
from kickbench.results.quantities import Quantity, over_seeds
from kickbench.results.store import RunDirectory
from kickbench.results.tables import left_out_lines
from kickbench.results.verdicts import Verdict, judge
from kickbench.trials.experiment import Condition, LoadedExperiment

SIDE_WORDS: dict[Side, str] = {"in_distribution": "in distribution", "mirrored": "mirrored"}


@dataclass(frozen=True, eq=False)
class Study:
    """An experiment, or all runs of one setting.

    Attributes:
        name: Its name.
        rows: Rows of `load_runs`, `condition` being the heading that a run is shown under.
        root: The folder of its runs.
        problems: What is left out, and why.
        curves: A row per training iteration, with condition, seed and path of the run.
        episodes: A row per episode of the evaluations, with condition, seed, path and side.
        experiment: The experiment, if it is one.
        verdicts: The verdicts on its claims.
    """

    name: str
    rows: pd.DataFrame
    root: Path
    curves: pd.DataFrame
    episodes: pd.DataFrame
    problems: Sequence[str] = ()
    experiment: LoadedExperiment | None = None
    verdicts: tuple[Verdict, ...] = ()

    @property
    def plans(self) -> Mapping[str, Condition]:
        """The conditions that an experiment plans, by name; empty without one."""
        return self.experiment.conditions if self.experiment else {}

    @property
    def has_reported(self) -> bool:
        """Whether something was reported of any condition."""
        return any(condition.reported for condition in self.plans.values())

    @property
    def runs(self) -> pd.DataFrame:
        """A row per run."""
        return runs_of(self.rows)

    @property
    def conditions(self) -> list[str]:
        """The conditions in their order."""
        return list(self.plans) or list(dict.fromkeys(self.runs.condition))

    @property
    def measured(self) -> pd.DataFrame:
        """A row per side of every run that counts, on its own task; with the columns study and label."""
        return self._labelled(self._on(None))

    def counted(self, condition: str) -> pd.DataFrame:
        """A row per run of a condition that counts."""
        return self.runs[self.runs.counted & (self.runs.condition == condition)]

    def estimates(self, quantity: Quantity, task: str | None = None) -> pd.DataFrame:
        """A figure of every condition, on every side that was measured or reported for any of them.

        Args:
            quantity: The figure.
            task: A transfer task, whose episodes are meant; None: the task trained on.

        Returns:
            Columns study, condition, side, label, those of `over_seeds`, reported and reported_std; NaN where
            there is nothing.
        """
        keys = pd.MultiIndex.from_tuples(product(self.conditions, SIDES), names=["condition", "side"])
        found = over_seeds(self._on(task), quantity).reindex(keys)
        reported = [self._reported(*key) for key in keys]
        for name, column in (("reported", quantity.column), ("reported_std", f"{quantity.column}_std")):
            found[name] = pd.Series([getattr(of, column, None) for of in reported], keys, dtype=float)
        known = (found["mean"].notna() | found.reported.notna()).groupby("side").transform("any")
        return self._labelled(found[known].reset_index())

    def swept(self, quantity: Quantity) -> pd.DataFrame:
        """A figure over the one number that the experiment sweeps; empty if it sweeps none, or several.

        Returns:
            Rows of `estimates` in distribution, with the columns of, the condition in the experiment's file,
            setting, its key, and value.
        """
        sweep = self.experiment.spec.sweep if self.experiment else None
        keys = list(sweep) if isinstance(sweep, dict) else []
        rows = self.estimates(quantity)
        rows = rows[(rows.side == HOME) & (rows.seeds > 0)]
        if len(keys) != 1 or rows.empty:
            return rows.iloc[:0]
        settings = {name: condition.settings for name, condition in self.plans.items()}
        texts = {name: own[-1].partition("=")[2] for name, own in settings.items()}
        values = pd.to_numeric(rows.condition.map(texts), errors="coerce")
        of = rows.condition.str.partition(POINT)[0]
        return rows.assign(of=of, setting=keys[0], value=values) if values.notna().all() else rows.iloc[:0]

    def _on(self, task: str | None) -> pd.DataFrame:
        """Rows that count of a transfer task, or of the task trained on."""
        return self.rows[self.rows.counted & (self.rows.evaluated_on == (task or self.rows.task))]

    def _labelled(self, rows: pd.DataFrame) -> pd.DataFrame:
        mirrored = rows.side.map({"in_distribution": "", "mirrored": ", mirrored"})
        return rows.assign(study=self.name, label=rows.condition + mirrored)

    def _reported(self, condition: str, side: Side) -> Any:
        reported = self.plans[condition].reported if condition in self.plans else None
        return reported and reported.of_side(side)


def studies(root: Path, experiment: LoadedExperiment | None = None) -> list[Study]:
    """What a folder holds: one study of the experiment, or without it one of every setting.

    Args:
        root: A run directory, or any folder above some; of an experiment the one with `<condition>/seed<k>`.
        experiment: What should be there.

    Raises:
        KickbenchError: There is no such folder, or no run in it, or its claims cannot be judged.
    """
    if not root.is_dir():
        raise KickbenchError(f"{root}: no such folder")
    frame = load_runs(root, experiment)
    if experiment is not None:
        rows, problems = frame[frame.condition.notna()], left_out_lines(frame[frame.condition.isna()])
        verdicts = judge(experiment, frame)
        return [Study(experiment.name, rows, root, *_files(runs_of(rows)), problems, experiment, verdicts)]
    if frame.empty:
        raise KickbenchError(f"{root}: no run in it, finished or not")
    frame["condition"] = frame.group.fillna(frame.method)
    settings = frame.groupby(frame.setting_name.fillna(frame.task), sort=False)
    parts = {str(name): rows.sort_values("seed", kind="stable") for name, rows in settings}
    return [Study(name, rows, root, *_files(runs_of(rows))) for name, rows in parts.items()]


def _files(runs: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Curves and episodes of runs that count, or are not finished and may."""
    names = ["condition", "seed", "path"]
    curves, episodes = [pd.DataFrame(columns=names)], [pd.DataFrame(columns=names)]
    for _, run in runs[runs.counted | runs.state.isin(["unfinished", "running"])].iterrows():
        directory, own = RunDirectory(run.path), {name: run[name] for name in names}
        if directory.progress.exists():
            curves.append(read_progress(directory.progress).assign(**own))
        if directory.episodes.exists():
            sides = zip(SIDES, read_episodes(directory.episodes), strict=True)
            episodes += [table.assign(**own, side=side) for side, table in sides if table is not None]
    return _joined(curves), _joined(episodes)


def _joined(tables: list[pd.DataFrame]) -> pd.DataFrame:
    return pd.concat(tables[1:] or tables, ignore_index=True)
