from typing import get_args

import pytest

from kickbench.config.experiment import OF_A_RUN, Bounded, ExperimentSpec, Metric, Ratio

HEAD = """\
task: table.yaml
seeds: [0, 1]
conditions:
  baseline: {method: table.yaml}
claims:
"""
CLAIM = "  c: {statement: It is so, kind: at_least, metric: success_rate, value: {condition: baseline}, bound: 0.5}\n"
TEXT = HEAD + CLAIM


def test_what_is_not_written_is_the_plainest(read):
    spec = read(ExperimentSpec, TEXT)
    claim = spec.claims["c"]
    assert isinstance(claim, Bounded)
    assert (claim.seeds, claim.section, claim.value.side, claim.value.task) == (
        "mean",
        "",
        "in_distribution",
        None,
    )
    assert (spec.iterations, spec.evaluation.episodes, spec.evaluation.transfer) == (None, None, ())
    assert spec.conditions["baseline"].reported is None


def test_the_operands_of_a_claim_are_found_by_their_keys(read):
    text = TEXT.replace("at_least", "ratio_at_most").replace(
        "bound", "over: {condition: baseline, side: mirrored}, bound"
    )
    claim = read(ExperimentSpec, text).claims["c"]
    assert isinstance(claim, Ratio)
    assert {key: operand.side for key, operand in claim.operands().items()} == {
        "value": "in_distribution",
        "over": "mirrored",
    }


def test_metrics_of_a_run_are_metrics():
    assert set(get_args(Metric)) > OF_A_RUN


@pytest.mark.parametrize(
    ("old", "new", "place", "message"),
    [
        ("[0, 1]", "[0, 1, 0]", "2:8: seeds", "the seed 0 is there twice: seeds are distinct"),
        ("[0, 1]", "[]", "2:8: seeds", "expected at least 1 item, found an empty list"),
        (
            "[0, 1]",
            "[-1]",
            "2:9: seeds.0",
            "expected a number greater than or equal to 0, found the number -1",
        ),
        (
            "[0, 1]",
            f"[{2**63}]",
            "2:9: seeds.0",
            f"expected a number less than or equal to {2**63 - 1}, found the number {2**63}",
        ),
        ("  baseline: {", "  a b: {", "4:3: conditions.a b", "unknown key 'a b'; expected a match of"),
        ("It is so", "''", "6:18: claims.c.statement", "expected at least 1 character, found"),
        ("[0, 1]", "[0]\niterations: 0", "3:13: iterations", "expected a number greater than 0, found"),
    ],
)
def test_values_are_bounded(complaints, old, new, place, message):
    found = complaints(ExperimentSpec, TEXT.replace(old, new))
    assert any(complaint.startswith(f"a.yaml:{place}: {message}") for complaint in found), found


def test_an_unknown_kind_names_the_nearest(complaints):
    (complaint,) = complaints(ExperimentSpec, TEXT.replace("at_least", "at_lest"))
    assert complaint.startswith("a.yaml:6:34: claims.c.kind: expected one of: at_least, at_most,")
    assert complaint.endswith("(did you mean 'at_least'?)")


def test_an_unknown_metric_lists_every_metric_once_and_names_the_nearest(complaints):
    (complaint,) = complaints(ExperimentSpec, TEXT.replace("success_rate", "sucess_rate"))
    assert complaint.startswith(
        f"a.yaml:6:52: claims.c.metric: expected one of: {', '.join(get_args(Metric))}, found"
    )
    assert complaint.endswith("(did you mean 'success_rate'?)")


@pytest.mark.parametrize(("kind", "said"), [("3", "the number 3"), ("null", "null"), ("[a]", "a list of 1")])
def test_a_kind_that_is_no_name_is_shown_as_it_is(complaints, kind, said):
    (complaint,) = complaints(ExperimentSpec, TEXT.replace("at_least", kind))
    assert complaint.endswith(f"near_reported, found {said}")


def test_a_kind_has_its_own_keys_only(complaints):
    (complaint,) = complaints(ExperimentSpec, TEXT.replace("bound", "minus: {condition: baseline}, bound"))
    keys = "statement, section, metric, terminations, reward, seeds, decidable, value, kind, bound"
    assert complaint == f"a.yaml:6:96: claims.c.minus: unknown key 'minus'; expected one of: {keys}"


@pytest.mark.parametrize(
    ("kind", "key"),
    [
        ("greater_than", "than"),
        ("difference_within", "minus"),
        ("ratio_at_most", "over"),
        ("at_most", "bound"),
    ],
)
def test_a_kind_needs_its_own_keys(complaints, kind, key):
    text = TEXT.replace("at_least", kind).replace(", bound: 0.5", "")
    assert any(
        f"claims.c.{key}: missing key '{key}'" in complaint for complaint in complaints(ExperimentSpec, text)
    )


def test_a_claim_has_a_kind(complaints):
    assert complaints(ExperimentSpec, TEXT.replace("kind: at_least, ", "")) == [
        "a.yaml:6:3: claims.c.kind: missing key 'kind'"
    ]


@pytest.mark.parametrize(("metric", "key"), [("termination_share", "terminations"), ("raw_reward", "reward")])
def test_some_metrics_need_a_name(complaints, metric, key):
    assert complaints(ExperimentSpec, TEXT.replace("success_rate", metric)) == [
        f"a.yaml:6:3: claims.c: the metric {metric} needs {key}: which?"
    ]
    given = TEXT.replace("success_rate", f"success_rate, {key}: " + ("[a]" if key == "terminations" else "a"))
    assert complaints(ExperimentSpec, given) == [
        f"a.yaml:6:3: claims.c: {key} is for the metric {metric}; the metric is success_rate"
    ]


def test_a_termination_is_not_counted_twice(complaints):
    given = TEXT.replace("success_rate", "termination_share, terminations: [fall, time_out, fall]")
    assert complaints(ExperimentSpec, given) == [
        "a.yaml:6:85: claims.c.terminations: the termination fall is there twice: terminations are distinct"
    ]


def test_every_arm_has_a_task(complaints, read):
    without = TEXT.removeprefix("task: table.yaml\n")
    (complaint,) = complaints(ExperimentSpec, without)
    assert complaint.endswith("the condition 'baseline' has no task, and the experiment has none for all")
    read(ExperimentSpec, without.replace("{method: table.yaml}", "{method: table.yaml, task: table.yaml}"))


def test_a_file_that_is_not_there_is_an_error_at_its_line(complaints):
    assert complaints(ExperimentSpec, TEXT.replace("{method: table.yaml}", "{method: tabel.yaml}")) == [
        "a.yaml:4:22: conditions.baseline.method: no such file: 'tabel.yaml' (did you mean 'table.yaml'?)"
    ]
