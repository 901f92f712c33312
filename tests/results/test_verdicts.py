"""Claims against runs made up on either side of their bounds."""

from __future__ import annotations

from pathlib import Path

import pytest

from kickbench.results.contrast import contrast_of
from kickbench.results.frame import load_runs
from kickbench.results.statistics import Interval
from kickbench.results.verdicts import judge, verdict_lines
from kickbench.trials.experiment import load_experiment

from ..made_up import write_result
from .conftest import planned_identity

ROOT = Path(__file__).parents[2]
HOME_AND_AWAY = "value: {arm: baseline}, minus: {arm: baseline, side: mirrored}"


@pytest.fixture
def verdict(experiment, make):
    """`verdict(claim, arms)` judges one claim by made-up metrics, `{arm: [metrics, ...]}`."""

    def verdict(claim: str, arms, **options):
        (found,) = judge(experiment(claim), make.measured(arms, **options))
        return found

    return verdict


@pytest.fixture
def seeds(make):
    """`seeds(home, mirrored)`: a run for each pair of success rates."""

    def seeds(home, mirrored=None, **options):
        away = mirrored or [None] * len(home)
        return [
            make.metrics(make.side(h), None if m is None else make.side(m), seed=seed, **options)
            for seed, (h, m) in enumerate(zip(home, away, strict=True))
        ]

    return seeds


@pytest.mark.parametrize(
    ("claim", "met", "not_met"),
    [
        ("kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5", 0.6, 0.4),
        ("kind: at_most, metric: success_rate, value: {arm: baseline}, bound: 0.5", 0.4, 0.6),
        (f"kind: difference_at_least, metric: success_rate, {HOME_AND_AWAY}, bound: 0.15", 0.8, 0.6),
        (f"kind: difference_at_most, metric: success_rate, {HOME_AND_AWAY}, bound: 0.15", 0.6, 0.8),
        (f"kind: difference_within, metric: success_rate, {HOME_AND_AWAY}, bound: 0.05", 0.5, 0.3),
        (f"kind: difference_within, metric: success_rate, {HOME_AND_AWAY}, bound: 0.05", 0.5, 0.7),
        (
            "kind: ratio_at_least, metric: success_rate, value: {arm: baseline}, "
            "over: {arm: baseline, side: mirrored}, bound: 1.5",
            0.8,
            0.7,
        ),
        (
            "kind: ratio_at_most, metric: success_rate, value: {arm: baseline}, "
            "over: {arm: baseline, side: mirrored}, bound: 1.5",
            0.7,
            0.8,
        ),
        (
            "kind: greater_than, metric: success_rate, value: {arm: baseline}, "
            "than: {arm: baseline, side: mirrored}",
            0.6,
            0.4,
        ),
        (
            "kind: less_than, metric: success_rate, value: {arm: baseline}, "
            "than: {arm: baseline, side: mirrored}",
            0.4,
            0.6,
        ),
    ],
)
@pytest.mark.parametrize("count", [1, 3])
def test_a_claim_is_met_on_one_side_of_its_bound_and_not_on_the_other(
    verdict, seeds, claim, met, not_met, count
):
    """The mirrored side succeeds in half of the episodes, seeds differ by a point or less."""
    spread = (-0.005, 0.0, 0.005)[:count]
    for rate, outcome in ((met, "met"), (not_met, "not met")):
        found = verdict(claim, {"baseline": seeds([rate + d for d in spread], [0.5 - d / 2 for d in spread])})
        assert found.outcome == (
            outcome if count == 3 else {"met": "holds", "not met": "does not hold"}[outcome]
        )
        assert found.words == (outcome if count == 3 else f"one policy: {found.outcome}")
        assert found.reason is None
        assert found.basis == ("3 seeds" if count == 3 else "episodes of one seed")


def test_an_interval_across_the_bound_is_not_enough_data(verdict, seeds):
    claim = "kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5"
    found = verdict(claim, {"baseline": seeds([0.4, 0.6, 0.62])})
    assert (found.outcome, found.reason) == ("not enough data", "the interval reaches across the bound")
    assert found.figure == pytest.approx(0.54)
    # Three seeds: t = 4.303, s = 0.1217; no share is above 1 or below 0.
    assert found.interval == pytest.approx((0.2378, 0.8422), abs=1e-4)


def test_methods_that_are_equal_are_not_told_apart(verdict, seeds):
    claim = "kind: greater_than, metric: success_rate, value: {arm: equivariant}, than: {arm: baseline}"
    rates = [0.69, 0.70, 0.71]
    arms = {"baseline": seeds(rates), "equivariant": seeds(rates, method="equivariant")}
    found = verdict(claim, arms)
    assert (found.outcome, found.figure) == ("not enough data", pytest.approx(0.0))


def test_two_arms_over_seeds_have_welchs_interval(verdict, seeds):
    claim = "kind: greater_than, metric: success_rate, value: {arm: equivariant}, than: {arm: baseline}"
    arms = {
        "equivariant": seeds([0.80, 0.82, 0.84], method="equivariant"),
        "baseline": seeds([0.60, 0.62, 0.64]),
    }
    found = verdict(claim, arms)
    # s = 0.02 in both, four degrees of freedom: 2.776 * sqrt(2 * 0.0004 / 3).
    assert found.interval == pytest.approx((0.2 - 0.04533, 0.2 + 0.04533), abs=1e-4)
    assert found.outcome == "met"


def test_a_missing_seed_is_not_enough_data_but_what_is_there_is_shown(verdict, seeds):
    claim = f"kind: difference_at_least, metric: success_rate, {HOME_AND_AWAY}, bound: 0.15"
    found = verdict(claim, {"baseline": [*seeds([0.80, 0.82], [0.10, 0.11]), None]})
    assert (found.outcome, found.reason) == ("not enough data", "baseline seed 2: missing")
    assert found.figure == pytest.approx(0.705)
    assert found.basis == "2 seeds"


def test_runs_that_deviate_from_the_plan_are_not_enough_data(verdict, seeds):
    claim = "kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5"
    found = verdict(claim, {"baseline": seeds([0.8, 0.8, 0.8])}, lack="scaled to 0.1")
    assert (found.outcome, found.reason) == ("not enough data", "baseline seeds 0, 1, 2: scaled to 0.1")


def test_nothing_measured_gives_no_figure(verdict):
    claim = "kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5"
    found = verdict(claim, {"baseline": [None, None, None]})
    assert (found.outcome, found.figure, found.interval) == ("not enough data", None, None)
    assert (found.measured, found.reason) == ("-", "baseline seeds 0, 1, 2: missing")


def test_a_run_without_the_mirrored_side_says_so(verdict, seeds):
    claim = f"kind: difference_at_least, metric: success_rate, {HOME_AND_AWAY}, bound: 0.15"
    found = verdict(claim, {"baseline": seeds([0.8])})
    assert (found.outcome, found.reason) == ("not enough data", "baseline seed 0: no success_rate")


def test_one_seed_has_the_interval_of_its_episodes(verdict, seeds):
    claim = "kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5"
    (run,) = seeds([0.52])
    found = verdict(claim, {"baseline": [run]})
    assert found.interval == pytest.approx(run.evaluation.in_distribution.success_ci)
    # 1,040 of 2,000 episodes do not show that it is above a half.
    assert found.outcome == "not enough data"


def test_mirrored_pairs_make_the_gap_of_one_policy_sharp(verdict, make):
    """85 % on both sides: independent episodes leave 2.2 points open, pairs of which three differ 0.2."""
    claim = f"kind: difference_within, metric: success_rate, {HOME_AND_AWAY}, bound: 0.01"
    sides = make.side(0.85), make.side(0.8495)
    alone = verdict(claim, {"baseline": [make.metrics(*sides)]})
    paired = make.metrics(*sides, asymmetry=make.asymmetry(only_original=2, only_mirrored=1))
    together = verdict(claim, {"baseline": [paired]})
    assert (alone.outcome, together.outcome) == ("not enough data", "holds")
    assert together.interval is not None
    assert together.interval.high < 0.003


def test_each_seed_must_meet_a_claim_about_each(verdict, make):
    claim = "kind: at_least, metric: favourite_foot_share, seeds: each, value: {arm: baseline}, bound: 0.9"

    def runs(*feet):
        return {"baseline": [make.metrics(make.side(0.5, feet=foot), seed=k) for k, foot in enumerate(feet)]}

    left, right = (950, 40, 960, 50), (10, 990, 20, 980)
    assert verdict(claim, runs(left, right, left)).outcome == "met"
    mixed = verdict(claim, runs(left, (500, 500, 500, 500), right))
    assert (mixed.outcome, mixed.figure, mixed.basis) == ("not met", 0.5, "worst of 3 seeds")
    # The mean over the seeds would hide it.
    unsure = verdict(claim, runs(left, (910, 100, 910, 100), right))
    assert (unsure.outcome, unsure.reason) == ("not enough data", "the interval reaches across the bound")


def test_the_foot_on_the_balls_side_is_counted(verdict, make):
    claim = "kind: at_least, metric: same_side_share, value: {arm: baseline}, bound: 0.7"
    near, far = make.side(0.5, feet=(800, 200, 200, 800)), make.side(0.5, feet=(200, 800, 800, 200))
    assert verdict(claim, {"baseline": [make.metrics(near)]}).outcome == "holds"
    assert verdict(claim, {"baseline": [make.metrics(far)]}).outcome == "does not hold"
    nobody = verdict(claim, {"baseline": [make.metrics(make.side(0.5))]})
    assert nobody.reason == "baseline seed 0: no same_side_share"


def test_shares_of_terminations_are_added_up(verdict, make):
    claim = (
        "kind: at_most, metric: termination_share, terminations: [time_out, double_touch], "
        "value: {arm: baseline}, bound: 0.02"
    )
    for falls, outcome in ((0.0, "holds"), (0.1, "does not hold")):
        assert verdict(claim, {"baseline": [make.metrics(make.side(0.5, falls=falls))]}).outcome == outcome


def test_the_equivariance_error_is_that_of_the_run(verdict, make):
    claim = "kind: at_most, metric: equivariance_error, value: {arm: baseline}, bound: 0.001"
    for error, outcome in ((1e-7, "holds"), (0.8, "does not hold")):
        run = make.metrics(make.side(0.5), asymmetry=make.asymmetry(error=error))
        assert verdict(claim, {"baseline": [run]}).outcome == outcome


def test_the_shown_ratio_and_its_interval_judge_as_the_verdict_does(verdict, seeds):
    claim = (
        "kind: ratio_at_most, metric: success_rate, value: {arm: baseline, side: mirrored}, "
        "over: {arm: baseline}, bound: 0.5"
    )
    found = verdict(claim, {"baseline": seeds([0.60, 0.58, 0.62], [0.15, 0.16, 0.14])})
    assert found.figure == pytest.approx(0.25)
    assert found.interval is not None
    assert found.interval.low < 0.25 < found.interval.high < 0.5
    assert found.outcome == "met"


def curves(path: Path, rows: list[tuple[float | str, float | str]], reward_per_step: float) -> None:
    """A progress table, cut short in the middle of a row; a number that is missing is an empty cell."""
    header = "iteration,mean_return,mean_episode_steps,reward_raw/action_rate"
    rewards = [n if n == "" else reward_per_step * float(n) for _, n in rows]
    cells = [f"{i},{r},{n},{reward}" for i, ((r, n), reward) in enumerate(zip(rows, rewards, strict=True))]
    (path / "progress.csv").write_text("\n".join([header, *cells, "99,1"]))


def measured_on_disk(experiment, make, folder, rows):
    """Three seeds of the baseline with one table, but for 1 % more and less reward and a longer last episode."""
    for seed in range(3):
        path = folder / f"baseline/seed{seed}"
        run = make.metrics(make.side(0.5), make.side(0.5), seed=seed)
        (*first, (r, n)) = rows
        path.mkdir(parents=True)
        curves(path, [*first, (r, n + seed / 10)], 1 + (seed - 1) / 100)
        write_result(path, run, planned_identity(experiment, "baseline"))
    return load_runs(folder, experiment)


@pytest.mark.parametrize(
    ("rows", "outcome"),
    [
        ([("", ""), (1, 10), (2, 21), (3, 29), (4, 40)], "met"),
        ([("", ""), (1, 40), (2, 31), (3, 19), (4, 10)], "not met"),
    ],
)
def test_the_return_that_follows_the_length_is_read_off_the_curves(experiment, make, tmp_path, rows, outcome):
    claim = "kind: at_least, metric: return_length_correlation, value: {arm: baseline}, bound: 0.9"
    spec = experiment(claim)
    (found,) = judge(spec, measured_on_disk(spec, make, tmp_path, rows))
    assert found.outcome == outcome


def test_a_raw_reward_is_a_mean_per_step_at_the_end_of_training(experiment, make, tmp_path):
    claim = "kind: at_most, metric: raw_reward, reward: action_rate, value: {arm: baseline}, bound: 1.1"
    spec = experiment(claim)
    rows = [("", "")] + [(0, 5)] * 17 + [(0, 7), (0, 9)]
    (found,) = judge(spec, measured_on_disk(spec, make, tmp_path, rows))
    assert (found.figure, found.outcome) == (pytest.approx(1.0), "met")
    assert found.interval == pytest.approx((1 - 0.0248, 1 + 0.0248), abs=1e-4)


def test_a_figure_that_is_equal_in_all_seeds_and_has_no_interval_says_so(experiment, make, tmp_path):
    claim = "kind: at_least, metric: return_length_correlation, value: {arm: baseline}, bound: 0.9"
    spec, rows = experiment(claim), [(1, 10), (2, 21), (3, 29), ("", 40)]
    (found,) = judge(spec, measured_on_disk(spec, make, tmp_path, rows))
    assert found.basis == "episodes of 3 seeds"
    assert found.reason == "all seeds give the same, and no interval is known of its figure"


def test_a_claim_without_curves_says_so(verdict, seeds):
    claim = "kind: at_least, metric: return_length_correlation, value: {arm: baseline}, bound: 0.9"
    assert (
        verdict(claim, {"baseline": seeds([0.5])}).reason == "baseline seed 0: no return_length_correlation"
    )


def test_the_lines_hold_every_claim_with_its_words(experiment, make, seeds):
    spec = experiment(
        "section: 4.3.2, kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5"
    )
    lines = verdict_lines(spec, judge(spec, make.measured({"baseline": seeds([0.79, 0.80, 0.81])})))
    assert lines[0] == "claims: made_up"
    assert "80.0 [77.5, 82.5] %" in lines[4]
    assert lines[-1] == "c0: S (thesis 4.3.2)"


@pytest.mark.parametrize("name", ["general", "home_field"])
def test_the_thesis_own_figures_meet_its_claims(name):
    experiment = load_experiment(ROOT / f"results/reported/{name}.yaml")
    verdicts = judge(experiment, load_runs("nowhere", experiment))
    reported = {v.name: v for v in verdicts if v.reported is not None and v.claim.kind != "near_reported"}
    assert len(reported) >= 5
    for name, verdict in reported.items():
        figure, claim = verdict.reported, verdict.claim
        if claim.kind.startswith("ratio"):  # the figure is the ratio, the contrast value - bound over
            assert figure <= claim.bound if claim.kind == "ratio_at_most" else figure >= claim.bound, name
        else:
            assert contrast_of(claim).holds(Interval(figure, figure)), name


def test_five_measured_seeds_of_the_mini_kicker_show_what_the_baseline_loses_and_leave_its_half_open():
    experiment = load_experiment(ROOT / "results/reported/mini_home_field.yaml")
    measured = load_runs(ROOT / "results/measured/mini_home_field", experiment)
    outcomes = {v.name: v.outcome for v in judge(experiment, measured)}
    assert outcomes["baseline_loses"] == "met"
    assert outcomes["baseline_fails_mirrored"] == "not enough data"
    assert outcomes["equivariant_keeps"] == outcomes["augmentation_keeps"] == "met"


def test_two_conditions_are_compared_in_every_seed(verdict, seeds, make):
    """Runs of the same seed: one pair that fails is enough to fail."""
    claim = "kind: greater_than, metric: success_rate, seeds: each, value: {arm: equivariant}, than: {arm: baseline}"
    worse = seeds([0.5, 0.6, 0.4])
    assert verdict(claim, {"baseline": worse, "equivariant": seeds([0.7, 0.8, 0.6])}).outcome == "met"
    mixed = verdict(claim, {"baseline": worse, "equivariant": seeds([0.7, 0.4, 0.6])})
    assert (mixed.outcome, mixed.figure) == ("not met", pytest.approx(-0.2))


def test_a_ratio_of_each_seed_is_shown_as_that_of_the_worst_one(verdict, make):
    claim = (
        "kind: ratio_at_most, metric: mean_distance, seeds: each, value: {arm: equivariant}, "
        "over: {arm: baseline}, bound: 0.8"
    )
    arms = {"equivariant": (0.9, 0.3), "baseline": (1.0, 3.0)}
    runs = {
        arm: [
            make.metrics(make.side(0.5, distance), method=arm, seed=seed) for seed, distance in enumerate(of)
        ]
        for arm, of in arms.items()
    }
    found = verdict(claim, runs)
    assert found.figure == pytest.approx(0.9)
    assert found.interval is not None
    assert found.interval.low == pytest.approx(0.875, abs=0.01)


def test_a_seed_that_one_condition_lacks_is_compared_with_no_other(verdict, seeds):
    claim = (
        "kind: difference_at_least, metric: success_rate, seeds: each, value: {arm: equivariant}, "
        "minus: {arm: baseline}, bound: -0.05"
    )
    first, _, last = seeds([0.2, 0.4, 0.6], method="equivariant")
    found = verdict(claim, {"equivariant": [first, None, last], "baseline": seeds([0.2, 0.4, 0.6])})
    assert (found.outcome, found.reason) == ("not enough data", "equivariant seed 1: missing")
    assert (found.figure, found.basis) == (pytest.approx(0.0), "worst of 2 seeds")
    apart = verdict(claim, {"equivariant": [first, None, None], "baseline": [None, *seeds([0.2, 0.4])[1:]]})
    assert (apart.figure, apart.basis) == (None, "-")


def test_a_claim_that_its_seeds_cannot_decide_says_so(experiment, make, seeds):
    spec = experiment(
        "decidable: false, kind: at_least, metric: success_rate, value: {arm: baseline}, bound: 0.5"
    )
    lines = verdict_lines(spec, judge(spec, make.measured({"baseline": seeds([0.8, 0.8])})))
    assert "c0: S; its seeds cannot decide it" in lines


def test_near_reported_with_the_arms_own_task_named_is_as_without(make):
    value = "{arm: baseline, task: mini_home_field}"
    claim = f"{{statement: S, kind: near_reported, metric: success_rate, value: {value}, bound: 0.1}}"
    figures = "{section: S, in_distribution: {success_rate: 0.5}}"
    overrides = [f"claims.near={claim}", f"arms.baseline.reported={figures}"]
    experiment = load_experiment(ROOT / "results/reported/mini_home_field.yaml", overrides)
    runs = [make.metrics(make.side(0.51), seed=seed) for seed in range(5)]
    verdicts = judge(experiment, make.measured({name: runs for name in experiment.conditions}))
    (near,) = (verdict for verdict in verdicts if verdict.name == "near")
    assert (near.outcome, near.reported) == ("met", 0.5)
