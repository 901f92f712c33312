"""Runs made up for tests of what is concluded from them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from kickbench.results.frame import frame_of
from kickbench.results.identity import Identity, identity_of
from kickbench.results.metrics import (
    Asymmetry,
    EquivarianceError,
    Evaluation,
    EvaluationMetrics,
    FootCounts,
    Kicks,
    LegPreference,
    Metrics,
    MirroredPairs,
)
from kickbench.results.statistics import Interval, wilson
from kickbench.trials.experiment import LoadedExperiment, load_experiment
from kickbench.trials.trial import load_trial

from ..made_up import made_up_metrics

ROOT = Path(__file__).parents[2]


def make_side(
    success: float,
    distance: float = 0.5,
    feet: tuple[int, int, int, int] = (0, 0, 0, 0),
    falls: float = 0.0,
    episodes: int = 2000,
) -> EvaluationMetrics:
    """A side; `feet`: kicks left and right with the ball on the left, then with the ball on the right."""
    left, right = (
        FootCounts(left_foot=pair[0], right_foot=pair[1], other=0, none=0) for pair in (feet[:2], feet[2:])
    )
    kicks, same = sum(feet), feet[0] + feet[3]
    return EvaluationMetrics(
        episodes=episodes,
        success_rate=success,
        success_ci=wilson(round(episodes * success), episodes),
        mean_distance=distance,
        mean_distance_ci=Interval(0.98 * distance, 1.02 * distance),
        median_distance=distance,
        median_distance_ci=Interval(0.98 * distance, 1.02 * distance),
        terminations={"target_hit": 1.0 - falls} | ({"time_out": falls} if falls else {}),
        kicks=Kicks(
            ball_left=left,
            ball_right=right,
            same_side_share=same / kicks if kicks else None,
            same_side_ci=wilson(same, kicks) if kicks else None,
        ),
        mean_episode_steps=60.0,
        kicked_fraction=1.0,
    )


def make_asymmetry(
    error: float | None = None, only_original: int | None = None, only_mirrored: int = 0, pairs: int = 2000
) -> Asymmetry:
    paired = None
    if only_original is not None:
        unlike = only_original + only_mirrored
        paired = MirroredPairs(
            pairs=pairs,
            agreement=1 - unlike / pairs,
            agreement_ci=wilson(pairs - unlike, pairs),
            foot_agreement=1.0,
            only_original=only_original,
            only_mirrored=only_mirrored,
            p_value=1.0,
        )
    equivariance = (
        None if error is None else EquivarianceError(states=100, rms=error, largest=error, relative=error)
    )
    legs = LegPreference(kicks=0, same_side_share=None, left_foot_share=None)
    return Asymmetry(equivariance=equivariance, legs=legs, pairs=paired)


def make_metrics(
    home: EvaluationMetrics,
    mirrored: EvaluationMetrics | None = None,
    method: str = "baseline",
    seed: int = 0,
    asymmetry: Asymmetry | None = None,
    iterations: int = 390,
    scale: float | None = None,
    task: str = "mini_home_field",
) -> Metrics:
    evaluation = Evaluation(in_distribution=home, mirrored=mirrored, asymmetry=asymmetry)
    return made_up_metrics(
        evaluation, task=task, method=method, seed=seed, scale=scale, iterations=iterations
    )


def make_measured(arms: dict[str, list[Metrics | None]], lack: str | None = None) -> pd.DataFrame:
    """Finished runs, None for one that is missing; `lack` is what all of them deviate from the plan in."""
    tables = []
    for arm, found in arms.items():
        for seed, metrics in enumerate(found):
            rows = frame_of([metrics or make_metrics(make_side(0.5))])
            rows["condition"], rows["seed"], rows["path"] = arm, seed, Path("nowhere", arm, f"seed{seed}")
            rows["problem"] = pd.Series([lack] * len(rows), dtype=object)
            if metrics is None:
                rows["state"], rows["counted"], rows["problem"] = "missing", False, "missing"
            tables.append(rows)
    return pd.concat(tables, ignore_index=True)


def planned_identity(experiment: LoadedExperiment, name: str) -> Identity:
    """The identity of the runs of a condition."""
    arm = experiment.conditions[name]
    files = arm.task.document.file, arm.method.document.file
    return identity_of(load_trial(*files, arm.settings))


class Make:
    """The makers above, under one name."""

    side = staticmethod(make_side)
    asymmetry = staticmethod(make_asymmetry)
    metrics = staticmethod(make_metrics)
    measured = staticmethod(make_measured)


@pytest.fixture
def make() -> type[Make]:
    return Make


@pytest.fixture
def experiment(tmp_path) -> Callable[..., LoadedExperiment]:
    """`experiment(claim, ...)` is the mini home-field experiment with these claims, `c0`, `c1`, ..., and no others."""

    def experiment(*claims: str) -> LoadedExperiment:
        arms = "\n".join(
            f"  {name}: {{method: {ROOT}/methods/mini/{name}.yaml}}"
            for name in ("baseline", "augmentation", "equivariant")
        )
        lines = "\n".join(f"  c{index}: {{statement: S, {claim}}}" for index, claim in enumerate(claims))
        path = tmp_path / "made_up.yaml"
        path.write_text(
            f"task: {ROOT}/tasks/mini_home_field.yaml\nseeds: [0, 1, 2]\narms:\n{arms}\nclaims:\n{lines}\n"
        )
        return load_experiment(path)

    return experiment
