"""The table of runs: right numbers under the right titles, whole, in plain ASCII."""

from collections.abc import Sequence

import pytest

from kickbench.results.frame import frame_of
from kickbench.results.metrics import Evaluation, EvaluationMetrics, FootCounts, Kicks, Metrics
from kickbench.results.provenance import Provenance
from kickbench.results.statistics import Interval, wilson
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


def side(rate: float, distance: float) -> EvaluationMetrics:
    nobody = FootCounts(left_foot=0, right_foot=0, other=0, none=500)
    return EvaluationMetrics(
        episodes=1000,
        success_rate=rate,
        success_ci=wilson(round(1000 * rate), 1000),
        mean_distance=distance,
        mean_distance_ci=Interval(distance, distance),
        median_distance=distance,
        median_distance_ci=Interval(distance, distance),
        terminations={"timeout": 1.0},
        kicks=Kicks(ball_left=nobody, ball_right=nobody, same_side_share=None, same_side_ci=None),
        mean_episode_steps=10,
        kicked_fraction=0,
    )


def run(
    method: str = "baseline",
    seed: int = 0,
    home: float = 0.853,
    mirrored: float | None = 0.301,
    task: str = "mini_home_field",
    iterations: int = 110,
    distance: float = 0.2,
) -> Metrics:
    there = None if mirrored is None else side(mirrored, 2 * distance)
    return Metrics(
        task=task,
        method=method,
        seed=seed,
        iterations=iterations,
        env_steps=2_027_520,
        training_seconds=100,
        evaluation=Evaluation(in_distribution=side(home, distance), mirrored=there),
        provenance=PROVENANCE,
    )


def render_table(runs: Sequence[Metrics]) -> str:
    return render_frame(frame_of(runs))


def rows_of(table: str, method: str) -> list[list[str]]:
    return [line.split() for line in table.splitlines() if line.startswith(method)]


def test_a_row_has_every_figure_of_its_run() -> None:
    (row,) = rows_of(render_table([run()]), "baseline")
    expected = [
        "baseline",
        "0",
        "85.3",
        "[83.0,",
        "87.4]",
        "30.1",
        "55.2",
        "0.200",
        "0.400",
        "110",
        "2,027,520",
    ]
    assert row == expected


def test_a_title_stands_above_each_column_with_its_unit() -> None:
    title, groups, header, _, row = render_table([run()]).splitlines()
    assert title == "task: mini_home_field"
    assert header.index("in-dist. [95 % CI]") + len("in-dist. [95 % CI]") == row.index("87.4]") + len("87.4]")
    assert header.rindex("mirrored") + len("mirrored") == row.index("0.400") + len("0.400")
    assert header.index("gap [pts]") + len("gap [pts]") == row.index("55.2") + len("55.2")
    assert groups.split("  ")[-1].strip() == "mean distance [m]"
    assert "success [%]" in groups


def test_several_seeds_are_followed_by_their_mean_and_standard_deviation() -> None:
    table = render_table([run(seed=2, home=0.9), run(seed=0, home=0.7), run(seed=1, home=0.8)])
    rows = rows_of(table, "baseline")
    assert [row[1] for row in rows] == ["0", "1", "2", "mean", "std"]
    assert rows[3][2:] == ["80.0", "30.1", "49.9", "0.200", "0.400", "110", "2,027,520"]
    assert rows[4][2:] == ["10.0", "0.0", "10.0", "0.000", "0.000"]


def test_a_single_seed_has_no_mean() -> None:
    assert "mean " not in render_table([run("baseline"), run("equivariant")]).split("---")[-1]


def test_a_mean_does_not_mix_what_is_not_common() -> None:
    rows = rows_of(render_table([run(seed=0), run(seed=1, mirrored=None)]), "baseline")
    assert rows[2][1:] == ["mean", "85.3", "-", "-", "0.200", "-", "110", "2,027,520"]


def test_a_run_without_mirrored_evaluation_has_dashes_there() -> None:
    (row,) = rows_of(render_table([run(mirrored=None)]), "baseline")
    assert row[5:] == ["-", "-", "0.200", "-", "110", "2,027,520"]


def test_a_gap_that_rounds_to_zero_has_no_sign() -> None:
    (row,) = rows_of(render_table([run(home=0.9, mirrored=0.9003)]), "baseline")
    assert row[6] == "0.0"


def test_tasks_have_blocks_of_their_own_and_methods_keep_their_order() -> None:
    table = render_table([run("b", task="one"), run("a", task="one"), run("a", task="two")])
    blocks = table.split("\n\n")
    assert [block.splitlines()[0] for block in blocks] == ["task: one", "task: two"]
    assert [line[0] for line in blocks[0].splitlines()[4:]] == ["b", "a"]


@pytest.mark.parametrize(
    "method", ["equivariant", "a_method_with_a_name_so_long_that_it_fills_half_the_line"]
)
def test_nothing_is_cut_off_and_everything_is_ascii(method: str) -> None:
    table = render_table([run(method, seed=seed, home=1.0, mirrored=0.0) for seed in range(12)])
    assert table.isascii()
    rows = rows_of(table, method)
    assert len(rows) == 14
    assert all(row[0] == method for row in rows)
    assert all(row[-1] == "2,027,520" for row in rows[:13])


def test_ordinary_names_fit_a_hundred_columns() -> None:
    methods = ("baseline", "augmentation", "equivariant")
    table = render_table([run(method, seed) for method in methods for seed in range(3)])
    assert max(map(len, table.splitlines())) <= 100


def test_no_runs_are_said_in_words() -> None:
    assert render_table([]) == "no finished runs"
