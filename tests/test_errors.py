import pickle

import pytest

from kickbench.errors import KickbenchError, Mark, Problem, SpecError, nearest, shown

MARK = Mark("tasks/mini.yaml", 3, 7)


def test_a_mark_reads_file_line_column():
    assert str(MARK) == "tasks/mini.yaml:3:7"
    assert MARK.place == "tasks/mini.yaml:3"


def test_a_mark_below_the_working_directory_is_shown_relative_to_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert str(Mark(str(tmp_path / "tasks" / "a.yaml"), 1, 2)) == "tasks/a.yaml:1:2"


def test_a_mark_elsewhere_is_shown_in_full(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    # `hereafter` begins like the working directory but is not below it.
    other = str(tmp_path / "hereafter" / "a.yaml")
    assert str(Mark(other, 1, 2)) == f"{other}:1:2"
    assert shown(other) == other


def test_the_mark_of_an_override_is_the_override_in_one_line():
    mark = Mark("--set rewards.x.weight=[3,\n 4]", 0, 0)
    assert str(mark) == mark.place == r"--set rewards.x.weight=[3,\n 4]"


def test_a_mark_without_line_is_the_file():
    assert str(Mark("a.yaml", 0, 0)) == "a.yaml"


def test_a_problem_is_one_readable_line():
    problem = Problem(MARK, ("rewards", "fall", "wieght"), "unknown key 'wieght'", "did you mean 'weight'?")
    assert str(problem) == (
        "tasks/mini.yaml:3:7: rewards.fall.wieght: unknown key 'wieght' (did you mean 'weight'?)"
    )


def test_a_problem_without_place_is_its_message():
    assert str(Problem(None, (), "no task given")) == "no task given"


def test_a_spec_error_lists_all_its_problems():
    problems = [Problem(MARK, ("a", 0), "first"), Problem(MARK, ("b",), "second")]
    error = SpecError(problems)
    assert error.problems == tuple(problems)
    assert str(error) == "tasks/mini.yaml:3:7: a.0: first\ntasks/mini.yaml:3:7: b: second"
    assert isinstance(error, KickbenchError)


def test_a_spec_error_survives_pickling():
    error = SpecError([Problem(MARK, ("a",), "first", "hint")])
    copy = pickle.loads(pickle.dumps(error))
    assert copy.problems == error.problems
    assert str(copy) == str(error)


def test_a_spec_error_of_an_override_names_it():
    assert str(SpecError.of("--set x=1", "no key 'x'", "try y")) == "--set x=1: no key 'x' (try y)"


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("wieght", "weight"),
        ("WEIGHT", "weight"),
        ("targetDistance", "target_distance"),
        ("target-distance", "target_distance"),
        ("target distance", "target_distance"),
        ("distance_target", "target_distance"),
        ("target_distnace", "target_distance"),
        ("target_distance", "target_distance"),
        ("zebra", None),
        ("", None),
    ],
)
def test_nearest_forgives_typing_case_separators_and_word_order(name, found):
    assert nearest(name, ["sigma", "weight", "target_distance", "target_angle"]) == found


def test_nearest_prefers_the_exact_name():
    assert nearest("a_b", ["AB", "A-B", "a_b"]) == "a_b"


def test_nearest_of_no_choices_is_none():
    assert nearest("a", iter(())) is None
