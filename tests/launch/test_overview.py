"""How far a run is, told from its files."""

from __future__ import annotations

import math

import pytest

from kickbench.launch.overview import read_state, read_tail, time_left


def test_a_folder_without_a_run_is_not_begun(make_run):
    state = read_state(make_run(), 450)
    assert (state.state, state.done, state.total) == ("not begun", 0, 450)
    assert math.isnan(state.success)
    assert state.iterations_left == 450


def test_an_interrupted_run_is_where_its_last_checkpoint_is(make_run):
    state = read_state(make_run(rows=117, checkpoints=(50, 100)), 450)
    assert (state.state, state.done, state.note) == ("interrupted", 100, "")
    assert state.success == pytest.approx(0.116)
    assert state.iterations_left * state.seconds_per_iteration == pytest.approx(350 * 2.0)


def test_a_damaged_checkpoint_counts_for_nothing(make_run):
    run = make_run(rows=117, checkpoints=(50, 100))
    newest = run.checkpoints / "iteration_000100.pt"
    newest.write_bytes(newest.read_bytes()[:-30])
    state = read_state(run, 450)
    assert (state.state, state.done) == ("interrupted", 50)
    assert "newest checkpoint is damaged" in state.note
    (run.checkpoints / "iteration_000050.pt").write_bytes(b"")
    state = read_state(run, 450)
    assert (state.state, state.note) == (
        "damaged",
        "every checkpoint is damaged: iteration_000100.pt",
    )


def test_a_run_that_has_trained_but_has_no_checkpoint_is_damaged(make_run):
    assert read_state(make_run(rows=3), 450).state == "damaged"


def test_a_run_that_is_trained_and_not_evaluated_says_so(make_run):
    state = read_state(make_run(rows=450, checkpoints=(400, 450)), 450)
    assert (state.state, state.note) == ("interrupted", "trained, not evaluated")


def test_a_finished_run_has_its_result(make_run):
    state = read_state(make_run(rows=450, checkpoints=(450,), finished=450), 450)
    assert (state.state, state.done, state.success) == ("finished", 450, 0.4)
    assert state.seconds_per_iteration == pytest.approx(100 / 450)


def test_a_result_of_fewer_iterations_than_wanted_is_not_finished(make_run):
    run = make_run(rows=450, checkpoints=(450,), finished=450)
    assert read_state(run, 900).state == "interrupted"
    assert read_state(run).state == "finished", "without a plan the result says what was wanted"


def test_a_damaged_result_is_damage_and_says_where(make_run):
    run = make_run(rows=450, checkpoints=(450,), finished=450)
    run.metrics.write_text("{")
    state = read_state(run, 450)
    assert (state.state, state.done) == ("damaged", 0)
    assert state.note.startswith("damaged (metrics.json: damaged")


def test_a_run_whose_folder_is_locked_is_running(make_run):
    run = make_run(rows=117, checkpoints=(100,))
    with run.occupied():
        state = read_state(run, 450)
        assert (state.state, state.done) == ("running", 117)
    assert read_state(run, 450).state == "interrupted"


def test_a_look_at_the_lock_keeps_no_run_out(make_run):
    run = make_run(checkpoints=(0,))
    for _ in range(20):
        assert not run.is_occupied
        with run.occupied():
            assert run.is_occupied


def test_the_tail_of_a_long_table_is_that_of_the_whole(make_run):
    run = make_run(rows=20_000)
    tail = read_tail(run.progress)
    assert tail["done"] == 20_000
    assert tail["steps_per_second"] == pytest.approx(100 + sum(range(19_980, 20_000)) / 20)
    assert tail["seconds_per_iteration"] == pytest.approx(2.0)


@pytest.mark.parametrize(
    "cut",
    ["7,1", "7,100,0.1,1.5,0.", "", "7,100,0.1,1.5,0.5"],
    ids=["short", "almost", "none", "no newline"],
)
def test_a_row_that_a_kill_cut_short_is_left_out(make_run, cut):
    run = make_run(rows=7)
    with open(run.progress, "a") as file:
        file.write(cut)
    tail = read_tail(run.progress)
    assert tail["done"] == 7


def test_what_is_no_progress_table_tells_nothing(make_run, tmp_path):
    assert read_tail(tmp_path / "nothing.csv") == {}
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    assert read_tail(tmp_path / "other.csv") == {}


def test_the_time_that_is_left_is_not_known_before_anything_was_measured(make_run):
    left = time_left([("baseline", read_state(make_run("new"), 450))])
    assert left == "unknown until the first iterations have been timed"


def test_the_pace_of_a_condition_is_that_of_its_runs(make_run):
    # 100 s of training and 20 s of evaluation for 450 iterations.
    finished = ("a", read_state(make_run("0", rows=450, finished=450), 450))
    new = ("a", read_state(make_run("1"), 450))
    assert time_left([finished, new]) == "about 2:00"
    assert time_left([finished]) == "about 0:00"


def test_a_condition_that_has_not_been_measured_takes_what_the_others_take(make_run):
    begun = ("a", read_state(make_run("0", rows=400, checkpoints=(400,)), 450))
    other = ("b", read_state(make_run("1"), 450))
    assert time_left([begun, other]) == "about 16:40 and evaluation"  # 50 + 450 iterations of 2 s


def test_runs_at_a_time_share_the_time_but_none_ends_before_its_own(make_run):
    long = ("a", read_state(make_run("0", rows=50, checkpoints=(50,)), 450))
    short = ("a", read_state(make_run("1", rows=400, checkpoints=(400,)), 450))
    assert time_left([long, short], at_a_time=1) == "about 15:00 and evaluation"
    assert time_left([long, short], at_a_time=2) == "about 13:20 and evaluation"
