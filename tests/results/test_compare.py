"""`kickbench compare`: run directories in, the right figures under the right titles out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from kickbench.cli import main
from kickbench.results.compare import SeedComparison, StartComparison, compare_on_starts, compare_seeds
from kickbench.results.episode_table import EpisodeSides, EpisodeTable, write_episodes
from kickbench.results.integrity import seal
from kickbench.results.metrics import load_metrics
from kickbench.results.statistics import mcnemar, welch
from kickbench.results.summary import summarise_sides

from ..made_up import made_up_metrics, write_result

STARTS, RADIUS = 200, 0.35


def episodes(rate: float, seed: int) -> EpisodeTable:
    """Episodes from the same starts for every policy; the share of successes is about `rate`."""
    fixed, own = np.random.default_rng(0), np.random.default_rng([1, seed])
    success = own.random(STARTS) < rate
    count, zeros = np.arange(STARTS), np.zeros(STARTS)
    return EpisodeTable(
        start_ball_x=fixed.uniform(0.2, 0.4, STARTS),
        start_ball_y=fixed.uniform(0.01, 0.3, STARTS),
        target_x=fixed.uniform(1, 2, STARTS),
        target_y=fixed.uniform(0, 1, STARTS),
        final_ball_x=zeros,
        final_ball_y=zeros,
        distance=np.where(success, 0.1, 0.9),
        success=success,
        termination=np.where(success, "target_hit", "time_out"),
        steps=count + 1,
        episode_return=zeros,
        kick_foot=np.full(STARTS, "left"),
        kick_step=0 * count,
        peak_ball_speed=zeros,
    )


def mirrored(table: EpisodeTable) -> EpisodeTable:
    return replace(
        table,
        start_ball_y=-table.start_ball_y,
        target_y=-table.target_y,
        kick_foot=np.full(STARTS, "right"),
    )


def write_run(folder: Path, method: str, seed: int, rate: float, *, table: bool = True) -> EpisodeTable:
    home = episodes(rate, seed)
    sides = EpisodeSides(home, mirrored(home))
    path = folder / method / f"seed{seed}"
    path.mkdir(parents=True)
    evaluation = summarise_sides(sides, RADIUS, 0.02)
    metrics = made_up_metrics(evaluation, task="a_task", method=method, seed=seed, iterations=450)
    if table:
        write_episodes(path / "episodes.csv", sides)
    write_result(path, metrics)
    return home


def compare(folder: Path, capsys) -> str:
    assert main(["compare", str(folder)]) == 0
    return capsys.readouterr().out


def rows(text: str, start: str) -> list[list[str]]:
    return [line.split() for line in text.splitlines() if line.startswith(start)]


def test_methods_have_a_row_and_pairs_have_theirs(tmp_path, capsys) -> None:
    rates = {("a", seed): write_run(tmp_path, "a", seed, 0.9).success.mean() for seed in range(3)}
    rates |= {("b", 3 + seed): write_run(tmp_path, "b", 3 + seed, 0.3).success.mean() for seed in range(3)}
    first, second = ([100 * rate for (name, _), rate in rates.items() if name == method] for method in "ab")
    text = compare(tmp_path, capsys)
    assert text.startswith("task: a_task: success in distribution [%]\n")
    assert rows(text, "a ")[0][:5] == [
        "a",
        "3",
        "450",
        f"{np.mean(first):.1f}",
        f"{np.std(first, ddof=1):.1f}",
    ]
    over_seeds, on_starts = rows(text, "a - b")[:2]
    difference = f"{np.mean(first) - np.mean(second):.1f}"
    assert over_seeds[3] == on_starts[3] == difference
    assert over_seeds[6:] == ["1.00", "[1.00,", "1.00]", "0.100", "0.100", "0.100"]
    assert on_starts[6:] == ["200", "<0.001", "<0.001"]


def test_policies_are_paired_by_start(tmp_path, capsys) -> None:
    tables = [write_run(tmp_path, name, seed, 0.8) for name, seed in (("a", 0), ("a", 1), ("b", 2), ("b", 3))]
    success = np.array([table.success for table in tables], dtype=float)
    expected = compare_on_starts(success[:2], success[2:])
    assert isinstance(expected, StartComparison)
    on_starts = rows(compare(tmp_path, capsys), "a - b")[1]
    assert on_starts[-2] == f"{expected.p_value:.3f}"
    low, high = (100 * end for end in expected.difference.interval)
    assert on_starts[4:6] == [f"[{low:z.1f},", f"{high:z.1f}]"]


def test_the_shorter_distance_is_the_better_one(tmp_path, capsys) -> None:
    for seed in range(2):
        write_run(tmp_path, "good", seed, 0.9)
        write_run(tmp_path, "poor", seed, 0.2)
    text = compare(tmp_path, capsys)
    block = text[text.index("mean distance in distribution [m]") :]
    assert rows(block, "good - poor")[0][3].startswith("-0.")
    assert rows(block, "good - poor")[0][6] == "1.00"


def test_one_seed_is_said_not_to_be_enough_and_policies_are_compared_all_the_same(tmp_path, capsys) -> None:
    write_run(tmp_path, "a", 0, 0.9)
    write_run(tmp_path, "b", 1, 0.3)
    text = compare(tmp_path, capsys)
    assert rows(text, "a - b ")[0][3:] == ["not", "enough", "data", "-", "-", "-", "-"]
    assert "a - b: the first method has one seed; two are the least" in text
    assert "on the same starts" in text
    assert rows(text, "a - b ")[1][-1] == "<0.001"


def test_runs_without_episodes_or_with_other_starts_are_not_compared_start_by_start(tmp_path, capsys) -> None:
    for seed in range(2):
        write_run(tmp_path, "a", seed, 0.9)
        write_run(tmp_path, "b", seed, 0.3, table=bool(seed))
    text = compare(tmp_path, capsys)
    assert "not compared on the same starts: 1 of 4 runs have no episodes.csv, such as" in text
    assert "b/seed0" in text
    assert len(rows(text, "a - b")) == 5
    home = episodes(0.3, 0)
    moved = replace(home, start_ball_x=home.start_ball_x + 0.01)
    write_episodes(tmp_path / "b/seed0/episodes.csv", EpisodeSides(moved, mirrored(moved)))
    seal(tmp_path / "b/seed0")
    assert "b/seed0 was evaluated from other starts than" in compare(tmp_path, capsys)


def test_another_result_of_the_same_seed_is_an_error_since_one_of_the_two_is_wrong(tmp_path, capsys) -> None:
    write_run(tmp_path / "one", "a", 0, 0.9)
    write_run(tmp_path / "two", "a", 0, 0.2)
    assert main(["compare", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert "two/a/seed0 holds seed 0 of a on a_task with another result than " in message
    assert "one/a/seed0" in message


def test_a_copied_seed_counts_once(tmp_path, capsys) -> None:
    for seed in range(2):
        write_run(tmp_path / "one", "a", seed, 0.9)
        write_run(tmp_path / "one", "b", seed, 0.3)
    once = compare(tmp_path, capsys)
    write_run(tmp_path / "two", "a", 0, 0.9)
    text = compare(tmp_path, capsys)
    assert rows(text, "a ") == rows(once, "a ")
    (line,) = [line for line in text.splitlines() if line.startswith("counted once: ")]
    assert line.endswith(f"is a copy of {tmp_path}/one/a/seed0")


def test_a_single_method_has_nothing_to_be_compared_with(tmp_path, capsys) -> None:
    write_run(tmp_path, "a", 0, 0.9)
    assert compare(tmp_path, capsys) == "no two methods of one task to compare\n"


def test_no_run_is_an_error(tmp_path, capsys) -> None:
    assert main(["compare", str(tmp_path)]) == 2
    assert "no finished run" in capsys.readouterr().err


def test_the_text_is_ascii_and_repeatable(tmp_path, capsys) -> None:
    for seed in range(3):
        write_run(tmp_path, "a", seed, 0.9)
        write_run(tmp_path, "b", seed, 0.8)
    text = compare(tmp_path, capsys)
    assert text.isascii()
    assert text == compare(tmp_path, capsys)


def test_a_method_without_a_figure_is_said_to_be_left_out_and_a_scaled_one_to_be_scaled(
    tmp_path, capsys
) -> None:
    for seed, method in enumerate("abc"):
        write_run(tmp_path, method, seed, 0.9, table=False)
    path = tmp_path / "c/seed2"
    metrics = load_metrics(path / "metrics.json")
    evaluation = metrics.evaluation.model_copy(update={"mirrored": None})
    write_result(path, metrics.model_copy(update={"evaluation": evaluation, "scale": 0.1}))
    text = compare(tmp_path, capsys)
    assert rows(text, "c ")[0][:4] == ["c", "1", "450", "scaled"]
    assert rows(text, "a ")[0][3] != "scaled"
    mirrored_block = text[text.index("success mirrored") : text.index("|success")]
    assert "c: left out, it has runs without this figure" in mirrored_block
    assert "c:" not in text[: text.index("success mirrored")].replace("b - c:", "").replace("a - c:", "")


def compared(first, second) -> StartComparison:
    outcome = compare_on_starts(first, second)
    assert isinstance(outcome, StartComparison)
    return outcome


def successes(seed: int, policies: int, rate: float, starts: int = 2000) -> np.ndarray:
    """Successes [policies, starts] of policies that find the same initial states hard."""
    hardness = np.random.default_rng(99).normal(size=starts)
    skill = stats.norm.ppf(rate) * np.sqrt(2)
    own = np.random.default_rng(seed).normal(size=(policies, starts))
    return (own + skill > hardness).astype(float)


def test_one_policy_each_is_mcnemars_test() -> None:
    x, y = successes(1, 1, 0.7), successes(2, 1, 0.68)
    only_x, only_y = int((x > y).sum()), int((y > x).sum())
    outcome = compared(x, y)
    assert outcome.p_value == pytest.approx(mcnemar(only_x, only_y), abs=0.03)
    assert outcome.difference.value == pytest.approx((only_x - only_y) / 2000)


def test_several_policies_agree_with_flipping_signs_at_random() -> None:
    x, y = successes(3, 3, 0.70, starts=400), successes(4, 2, 0.67, starts=400)
    difference = x.mean(axis=0) - y.mean(axis=0)
    expected = stats.permutation_test(
        (difference,), np.sum, permutation_type="samples", n_resamples=9999, rng=np.random.default_rng(0)
    )
    assert compared(x, y).p_value == pytest.approx(expected.pvalue, abs=0.02)


def test_seeds_on_one_initial_state_count_as_one_observation() -> None:
    """A policy entered three times is no more evidence than once."""
    x, y = successes(5, 1, 0.7), successes(6, 1, 0.66)
    thrice = compared(np.repeat(x, 3, axis=0), np.repeat(y, 3, axis=0))
    assert thrice.p_value == pytest.approx(compared(x, y).p_value)


def test_intervals_cover_the_truth_and_the_test_keeps_its_level() -> None:
    repeats, inside, rejected = 400, 0, 0
    for seed in range(repeats):
        source = np.random.default_rng(seed)
        hardness = source.normal(size=300)
        x, y = ((source.normal(size=(3, 300)) > hardness).astype(float) for _ in range(2))
        outcome = compared(x, y)
        inside += outcome.difference.interval.low <= 0 <= outcome.difference.interval.high
        rejected += outcome.p_value < 0.05
    assert 0.92 < inside / repeats < 0.98
    assert 0.02 < rejected / repeats < 0.08


def test_equal_outcomes_are_no_difference_and_few_unequal_ones_no_answer() -> None:
    x = successes(7, 1, 0.7)
    assert compared(x, x) == ((0.0, (0.0, 0.0)), 2000, 1.0)
    other = x.copy()
    other[0, :5] = 1 - other[0, :5]
    assert compare_on_starts(x, other) == "the policies differ on 5 of 2000 starts; 30 are the least"
    assert isinstance(compare_on_starts(x[:, :29], x[:, :29]), str)


def test_two_methods_over_three_seeds() -> None:
    outcome = compare_seeds([0.7, 0.8, 0.9], [0.1, 0.2, 0.3])
    assert isinstance(outcome, SeedComparison)
    assert outcome.difference == welch([0.7, 0.8, 0.9], [0.1, 0.2, 0.3])
    assert outcome.improvement == (1.0, (1.0, 1.0))
    assert (outcome.p_value, outcome.smallest_p) == pytest.approx((0.1, 0.1))


def test_a_smaller_distance_can_be_the_better_one() -> None:
    outcome = compare_seeds([0.2, 0.3], [0.8, 0.9], lower_is_better=True)
    assert isinstance(outcome, SeedComparison)
    assert outcome.difference.value == pytest.approx(-0.6)
    assert outcome.improvement.value == 1


def test_p_values_are_adjusted_for_all_pairs_that_have_one(tmp_path, capsys) -> None:
    for method, rate, seeds in (("a", 0.9, 4), ("b", 0.3, 4), ("c", 0.6, 4), ("d", 0.5, 1)):
        for seed in range(seeds):
            write_run(tmp_path, method, seed, rate, table=False)
    text = compare(tmp_path, capsys)
    first = text[: text.index("success mirrored")]
    assert [row[-1] for row in rows(first, "a - ")[:2]] == ["0.086", "0.086"], "3 times 2/70"
    assert rows(first, "a - d")[0][-1] == "-"
    assert "a - d: the second method has one seed; two are the least" in first
