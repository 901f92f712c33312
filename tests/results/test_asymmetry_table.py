"""The table of left against right: there where runs tell it, and readable."""

from collections.abc import Sequence

import pytest

from kickbench.results.asymmetry import (
    Asymmetry,
    EquivarianceError,
    LegPreference,
    MirroredPairs,
    SideSuccess,
)
from kickbench.results.frame import frame_of
from kickbench.results.metrics import Evaluation, EvaluationMetrics, FootCounts, Kicks, Metrics
from kickbench.results.provenance import Provenance
from kickbench.results.statistics import Interval
from kickbench.results.table import render_table as render_frame

PROVENANCE = Provenance(
    versions={},
    device="a processor",
    num_threads=1,
    platform="Linux",
    seed=0,
    commit=None,
    dirty=None,
    started="",
    finished="",
    seconds=0,
    env_steps=0,
    command=[],
)


def asymmetry(left: float = 0.75, p: float = 0.0321, error: float | None = 0.1234) -> Asymmetry:
    return Asymmetry(
        equivariance=None
        if error is None
        else EquivarianceError(states=10, rms=error, largest=error, relative=error),
        legs=LegPreference(
            kicks=100,
            same_side_share=0.551,
            same_side_ci=Interval(0.541, 0.562),
            left_foot_share=left,
            left_foot_ci=Interval(left - 0.01, left + 0.01),
        ),
        success=SideSuccess(
            left_episodes=50,
            left_rate=0.748,
            right_episodes=50,
            right_rate=0.178,
            difference=0.57,
            difference_ci=Interval(0.5, 0.6),
            z=9.0,
            p_value=p,
        ),
        pairs=MirroredPairs(
            pairs=50,
            agreement=0.248,
            agreement_ci=Interval(0.2, 0.3),
            foot_agreement=0.1,
            only_original=30,
            only_mirrored=2,
            p_value=0.001,
        ),
    )


def run(
    method: str = "baseline", seed: int = 0, found: Asymmetry | None = None, task: str = "mini_home_field"
) -> Metrics:
    nobody = FootCounts(left_foot=0, right_foot=0, other=0, none=500)
    side = EvaluationMetrics(
        episodes=1000,
        success_rate=0.5,
        success_ci=Interval(0.4, 0.6),
        mean_distance=0.2,
        mean_distance_ci=Interval(0.2, 0.2),
        median_distance=0.2,
        median_distance_ci=Interval(0.2, 0.2),
        terminations={"timeout": 1.0},
        kicks=Kicks(ball_left=nobody, ball_right=nobody, same_side_share=None, same_side_ci=None),
        mean_episode_steps=10,
        kicked_fraction=0,
    )
    return Metrics(
        task=task,
        method=method,
        seed=seed,
        iterations=450,
        env_steps=2_764_800,
        training_seconds=100,
        evaluation=Evaluation(in_distribution=side, asymmetry=found),
        provenance=PROVENANCE,
    )


def render_table(runs: Sequence[Metrics]) -> str:
    return render_frame(frame_of(runs))


def block(*runs: Metrics) -> list[list[str]]:
    """Rows of the asymmetry table by their cells."""
    text = next(part for part in ("\n\n" + render_table(runs)).split("\n\nasymmetry: ")[1:])
    return [line.split() for line in text.splitlines()[4:] if line]


def test_a_row_has_every_figure_of_its_run() -> None:
    (row,) = block(run(found=asymmetry()))
    assert row[:7] == ["baseline", "0", "12.34", "55.1", "[54.1,", "56.2]", "75.0"]
    assert row[7:] == ["[74.0,", "76.0]", "74.8", "17.8", "0.032", "24.8"]


def test_runs_that_do_not_tell_are_left_out_and_none_means_no_table() -> None:
    assert "asymmetry" not in render_table([run(), run(seed=1)])
    assert [row[0] for row in block(run("old"), run("new", found=asymmetry()))] == ["new"]


def test_every_task_is_followed_by_its_own() -> None:
    titles = [
        line
        for line in render_table(
            [run(found=asymmetry(), task="one"), run(found=asymmetry(), task="two")]
        ).splitlines()
        if ": " in line
    ]
    assert titles == ["task: one", "asymmetry: one", "task: two", "asymmetry: two"]


def test_what_is_not_known_is_a_dash() -> None:
    nothing = Asymmetry(legs=LegPreference(kicks=0, same_side_share=None, left_foot_share=None))
    assert block(run(found=nothing)) == [["baseline", "0", *7 * ["-"]]]


def test_a_small_p_is_bounded() -> None:
    assert "<0.001" in block(run(found=asymmetry(p=1e-20)))[0]
    assert "1.000" in block(run(found=asymmetry(p=1.0)))[0]


def test_several_seeds_are_followed_by_mean_and_standard_deviation() -> None:
    rows = block(*(run(seed=seed, found=asymmetry(left)) for seed, left in enumerate((0.6, 0.7, 0.8))))
    assert [row[1] for row in rows] == ["0", "1", "2", "mean", "std"]
    assert rows[3][2:] == ["12.34", "55.1", "70.0", "74.8", "17.8", "-", "24.8"]
    assert rows[4][2:] == ["0.00", "0.0", "10.0", "0.0", "0.0", "-", "0.0"]


def test_a_mean_does_not_mix_what_only_some_seeds_have() -> None:
    rows = block(run(found=asymmetry()), run(seed=1, found=asymmetry(error=None)))
    assert rows[2][:4] == ["baseline", "mean", "-", "55.1"]


@pytest.mark.parametrize("method", ["relaxed_equivariant", "baseline"])
def test_it_is_ascii_of_at_most_110_columns(method: str) -> None:
    certain = asymmetry(left=0.5, p=1e-9).model_copy(
        update={
            "legs": LegPreference(
                kicks=1,
                same_side_share=1.0,
                same_side_ci=Interval(1, 1),
                left_foot_share=1.0,
                left_foot_ci=Interval(1, 1),
            )
        }
    )
    text = render_table([run(method, seed, certain) for seed in range(3)])
    assert text.isascii()
    assert max(map(len, text.splitlines())) <= 112
