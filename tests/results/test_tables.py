"""The tables of runs: right numbers under the right titles, whole, in plain ASCII."""

from collections.abc import Sequence

import pytest

from kickbench.results.frame import frame_of
from kickbench.results.metrics import (
    Asymmetry,
    EquivarianceError,
    LegPreference,
    Metrics,
    MirroredPairs,
    SideSuccess,
)
from kickbench.results.statistics import Interval
from kickbench.results.tables import render_table as render_frame

from .conftest import make_asymmetry, make_metrics, make_side


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
    method: str = "baseline",
    seed: int = 0,
    found: Asymmetry | None = None,
    *,
    home: float = 0.853,
    mirrored: float | None = 0.301,
    task: str = "mini_home_field",
    distance: float = 0.2,
) -> Metrics:
    there = None if mirrored is None else make_side(mirrored, 2 * distance, episodes=1000)
    metrics = make_metrics(
        make_side(home, distance, episodes=1000), there, method, seed, found, iterations=110, task=task
    )
    return metrics.model_copy(update={"env_steps": 2_027_520})


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


def block(*runs: Metrics) -> list[list[str]]:
    """Rows of the asymmetry table by their cells."""
    text = next(part for part in ("\n\n" + render_table(runs)).split("\n\nasymmetry: ")[1:])
    return [line.split() for line in text.splitlines()[4:] if line]


def test_a_row_of_the_asymmetry_has_every_figure_of_its_run() -> None:
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


def test_seeds_of_an_asymmetry_are_followed_by_mean_and_standard_deviation() -> None:
    rows = block(*(run(seed=seed, found=asymmetry(left)) for seed, left in enumerate((0.6, 0.7, 0.8))))
    assert [row[1] for row in rows] == ["0", "1", "2", "mean", "std"]
    assert rows[3][2:] == ["12.34", "55.1", "70.0", "74.8", "17.8", "-", "24.8"]
    assert rows[4][2:] == ["0.00", "0.0", "10.0", "0.0", "0.0", "-", "0.0"]


def test_a_mean_of_an_asymmetry_does_not_mix_what_only_some_seeds_have() -> None:
    rows = block(run(found=asymmetry()), run(seed=1, found=asymmetry(error=None)))
    assert rows[2][:4] == ["baseline", "mean", "-", "55.1"]


@pytest.mark.parametrize("method", ["relaxed_equivariant", "baseline"])
def test_the_asymmetry_is_ascii_of_at_most_110_columns(method: str) -> None:
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


def test_a_partial_symmetry_is_named_below_the_table():
    asymmetry = make_asymmetry(1e-9)
    assert asymmetry.equivariance is not None
    partial = asymmetry.equivariance.model_copy(update={"but_for": ("ball_position",)})
    runs = [
        make_metrics(make_side(0.5), method="baseline", asymmetry=asymmetry),
        make_metrics(
            make_side(0.5), method="partial", asymmetry=asymmetry.model_copy(update={"equivariance": partial})
        ),
    ]
    assert render_frame(frame_of(runs)).splitlines()[-1] == "partial: equivariant but for: ball_position"
