"""What a training shows: lines or a bar for a person, progress.csv and TensorBoard for machines."""

from __future__ import annotations

import csv
import io
import math
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from kickbench.errors import KickbenchError
from kickbench.evaluation import progress_bar as console
from kickbench.evaluation.progress_bar import Steps, duration, percent, tracked
from kickbench.results.progress_table import whole_rows
from kickbench.training.iteration_log import Record, RunProgress, describe

FIRST = {
    "iteration": 0,
    "env_steps": 12_288,
    "steps_per_second": 20_345.6,
    "mean_return": 1.5,
    "mean_episode_steps": 80.0,
    "success_rate": math.nan,
    "resets_nonfinite": 0,
    "termination/fell": 0.25,
    "termination/timeout": 0.75,
    "termination/target_reached": 0.0,
    "reward/target_distance": 1.0,
    "reward_raw/target_distance": 0.004,
    "loss/value": 0.1,
    "loss/surrogate": -0.01,
}


def record(iteration: int, **changes: float) -> Record:
    own = {"iteration": iteration, "env_steps": 12_288 * (iteration + 1), "success_rate": 0.713}
    return FIRST | own | changes


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test moves."""
    now = [100.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])

    def wait(seconds: float) -> None:
        now[0] += seconds

    return wait


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def rows_of(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def quiet(path: Path) -> RunProgress:
    return RunProgress(path, path.parent / "tensorboard", io.StringIO())


def write_rows(path: Path, iterations: Sequence[int], first: int = 0) -> None:
    progress = quiet(path)
    progress.start(100, first)
    for iteration in iterations:
        progress.update(record(iteration))
    progress.close()


def test_a_line_every_ten_seconds_and_the_last_one(clock):
    stream = io.StringIO()
    with Steps("training", "iterations", 1_000, stream=stream) as steps:
        for _ in range(9):
            clock(4.0)
            steps.advance(text="fine")
    assert stream.getvalue().splitlines() == [
        "training: 3 of 1,000 iterations, 1:06:28 left  fine",
        "training: 6 of 1,000 iterations, 1:06:16 left  fine",
        "training: 9 of 1,000 iterations, 1:06:04 left  fine",
    ]


def test_what_is_done_at_once_prints_nothing_unless_there_is_something_to_say(clock):
    stream = io.StringIO()
    with Steps("evaluating", "episodes", 10, stream=stream) as steps:
        steps.advance(10)
    assert stream.getvalue() == ""
    with Steps("training", "iterations", 10, stream=stream) as steps:
        steps.advance(text="fine")
    assert stream.getvalue().splitlines() == ["training: 1 of 10 iterations, 0:00 left  fine"]


def test_time_left_counts_from_the_resume(clock):
    stream = io.StringIO()
    with Steps("training", "iterations", 100, done=80, stream=stream) as steps:
        clock(20.0)
        steps.advance(2)
    assert stream.getvalue() == "training: 82 of 100 iterations, 3:00 left\n"


def test_items_are_counted_where_their_number_is_not_known(clock, capsys):
    for _ in tracked(range(3), "drawing", "frames"):
        clock(6.0)
    assert capsys.readouterr().err == "drawing: 2 frames\n"


def test_a_terminal_gets_a_bar():
    stream = Terminal()
    with Steps("training", "iterations", 10, stream=stream) as steps:
        steps.advance(4, text="[success] 71.3 %")
    last = stream.getvalue().rpartition("training")[2]
    assert "4/10" in last
    assert "[success] 71.3 %" in last


def test_a_record_is_one_line_with_speed_return_success_and_terminations():
    text = describe(record(0, **{"evaluation/mirrored": 0.5, "evaluation/in_distribution": math.nan}))
    assert text == "20,346 steps/s  return 1.50  success 71.3 %  timeout 75 %, fell 25 %  mirrored 50.0 %"


def test_envs_that_diverged_and_missing_room_are_shouted_about():
    text = describe(record(0, resets_nonfinite=3, speeding_share=0.034, **{"load/short_share": 0.01}))
    assert "JOINTS BEYOND THEIR VELOCITY LIMIT: 3% of the steps" in text
    assert "BEYOND" not in describe(record(0, speeding_share=0.001))
    assert "NON-FINITE ENVS RESET: 3" in text
    assert "STEPS SHORT OF ROOM FOR CONTACTS: 1.000%" in text


def test_before_the_first_episode_ends_nothing_reads_nan():
    unknown = {name: math.nan for name in FIRST if name.startswith(("mean", "success", "termination"))}
    assert describe(FIRST | unknown) == "20,346 steps/s  return -  success -"


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0:00"), (59.6, "1:00"), (200, "3:20"), (3909, "1:05:09"), (math.nan, "-")]
)
def test_durations_read_like_a_clock(seconds, text):
    assert duration(seconds) == text


def test_a_rate_that_is_not_known_yet_is_a_dash():
    assert percent(math.nan) == "-"
    assert percent(1.0) == "100.0 %"


def test_the_table_has_a_column_for_each_figure(tmp_path):
    write_rows(tmp_path / "progress.csv", range(3))
    rows = rows_of(tmp_path / "progress.csv")
    assert [row["iteration"] for row in rows] == ["0", "1", "2"]
    assert rows[2]["env_steps"] == "36864"
    assert [*rows[2]] == [*FIRST]
    assert float(rows[2]["reward_raw/target_distance"]) == 0.004


def test_rows_are_on_disk_before_the_training_ends(tmp_path):
    progress = quiet(tmp_path / "progress.csv")
    progress.start(10, 0)
    progress.update(FIRST)
    assert rows_of(tmp_path / "progress.csv")[0]["success_rate"] == "nan"
    progress.close()


def test_numpy_integers_keep_every_digit(tmp_path):
    progress = quiet(tmp_path / "progress.csv")
    progress.start(10, 0)
    progress.update(record(0, env_steps=np.int64(123_456_789)))
    progress.close()
    assert rows_of(tmp_path / "progress.csv")[0]["env_steps"] == "123456789"


def test_a_resumed_table_is_the_table_of_a_run_that_was_never_stopped(tmp_path):
    write_rows(tmp_path / "whole.csv", range(10))
    write_rows(tmp_path / "resumed.csv", range(7))
    with open(tmp_path / "resumed.csv", "a") as file:
        file.write("7,98304,20")  # a kill in the middle of a row
    write_rows(tmp_path / "resumed.csv", range(4, 10), first=4)
    assert (tmp_path / "resumed.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_figures_that_an_older_version_did_not_report_are_empty_in_its_rows(tmp_path):
    write_rows(tmp_path / "progress.csv", range(3))
    progress = quiet(tmp_path / "progress.csv")
    progress.start(10, 2)
    progress.update(record(2, speeding_share=0.25))
    progress.close()
    assert [row["speeding_share"] for row in rows_of(tmp_path / "progress.csv")] == ["", "", "0.25"]
    assert [row[-1] for row in whole_rows(tmp_path / "progress.csv")] == ["speeding_share", "", "", "0.25"]


def test_a_run_that_starts_anew_drops_the_old_rows(tmp_path):
    write_rows(tmp_path / "progress.csv", range(7))
    write_rows(tmp_path / "progress.csv", range(2))
    assert [row["iteration"] for row in rows_of(tmp_path / "progress.csv")] == ["0", "1"]


def test_a_figure_that_is_absent_once_leaves_its_cell_empty_and_a_new_one_is_an_error(tmp_path):
    progress = quiet(tmp_path / "progress.csv")
    progress.start(10, 0)
    progress.update(FIRST)
    progress.update({name: value for name, value in record(1).items() if name != "loss/surrogate"})
    with pytest.raises(KickbenchError, match="no column for loss/entropy"):
        progress.update(record(2, **{"loss/entropy": 0.1}))
    progress.close()
    assert rows_of(tmp_path / "progress.csv")[1]["loss/surrogate"] == ""


@pytest.mark.parametrize("text", ["some other file\n", "iteration,env_steps\n1\n", "iteration\nx\n"])
def test_a_table_that_is_none_of_ours_is_not_touched(tmp_path, text):
    path = tmp_path / "progress.csv"
    path.write_text(text)
    with pytest.raises(KickbenchError, match=r"progress\.csv"):
        quiet(path).start(10, 5)
    assert path.read_text() == text


def test_tensorboard_gets_every_figure_but_not_what_is_unknown(tmp_path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    progress = quiet(tmp_path / "progress.csv")
    progress.start(10, 0)
    progress.update(FIRST)
    progress.update(record(1))
    progress.close()
    events = accumulator.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    success = events.Scalars("train/success_rate")
    assert [(event.step, event.value) for event in success] == [(1, pytest.approx(0.713))]
    assert [event.step for event in events.Scalars("reward/target_distance")] == [0, 1]


def test_a_run_writes_lines_rows_and_events(tmp_path):
    stream = io.StringIO()
    progress = RunProgress(tmp_path / "progress.csv", tmp_path / "tensorboard", stream)
    progress.start(2, 0)
    progress.update(FIRST)
    progress.update(record(1))
    progress.close()
    progress.close()
    first, last = stream.getvalue().splitlines()
    assert first == "training: 2 iterations"
    assert last.startswith("training: 2 of 2 iterations, 0:00 left  20,346 steps/s")
    assert len(rows_of(tmp_path / "progress.csv")) == 2
    assert list((tmp_path / "tensorboard").iterdir())


def test_a_resumed_run_says_where_it_goes_on(tmp_path):
    write_rows(tmp_path / "progress.csv", range(7))
    stream = io.StringIO()
    progress = RunProgress(tmp_path / "progress.csv", tmp_path / "tensorboard", stream)
    progress.start(9, 7)
    progress.close()
    assert stream.getvalue() == "training: 9 iterations, resumed at 7\n"


def test_everything_is_closed_even_when_one_place_fails(tmp_path, monkeypatch):
    def fail(self) -> None:
        raise OSError("disk full")

    progress = quiet(tmp_path / "progress.csv")
    monkeypatch.setattr("torch.utils.tensorboard.writer.SummaryWriter.close", fail)
    progress.start(2, 0)
    progress.update(FIRST)
    with pytest.raises(OSError, match="disk full"):
        progress.close()
    assert progress._table.closed


def test_importing_the_console_s_progress_loads_nothing_heavy():
    heavy = ("torch", "rich", "tensorboard", "numpy", "mujoco")
    code = f"import sys, kickbench.evaluation.progress_bar; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_rows_of_an_older_table_lose_their_checks_on_a_resume(tmp_path):
    path = tmp_path / "progress.csv"
    write_rows(path, range(3))
    whole = path.read_text()
    header, *rows = whole.splitlines()
    path.write_text(
        "".join(f"{line}\n" for line in (f"{header},crc32", *(f"{row},0badc0de" for row in rows)))
    )
    assert len(whole_rows(path)) == 4
    write_rows(path, [2], first=2)
    assert path.read_text() == whole
