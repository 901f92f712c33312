"""What a training shows: lines and panel for a person, progress.csv and TensorBoard for machines."""

import csv
import io
import math
import random
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kickbench.errors import KickbenchError
from kickbench.results.progress import checked_rows
from kickbench.training.progress import (
    Countdown,
    IterationRecord,
    PlainProgress,
    ProgressGroup,
    console_progress,
    describe_terminations,
    duration,
    percent,
    standard_progress,
)
from kickbench.training.progress_files import CsvProgress, TensorBoardProgress
from kickbench.training.progress_terminal import TerminalProgress

FIRST = IterationRecord(
    iteration=0,
    env_steps=12_288,
    steps_per_second=20_345.6,
    mean_return=1.5,
    mean_episode_steps=80.0,
    success_rate=math.nan,
    terminations={"fell": 0.25, "timeout": 0.75, "target_reached": 0.0},
    rewards={"target_distance": 1.0, "fall": -0.5},
    rewards_raw={"target_distance": 0.004, "fall": 1.0},
    losses={"value": 0.1, "surrogate": -0.01},
    learning_rate=3e-3,
    action_std=0.6,
    collect_seconds=0.5,
    update_seconds=0.25,
    resets_nonfinite=0,
)


def record(iteration: int, **changes: object) -> IterationRecord:
    values: dict = {
        "iteration": iteration,
        "env_steps": 12_288 * (iteration + 1),
        "success_rate": 0.713,
        **changes,
    }
    return replace(FIRST, **values)


class Clock:
    """A clock that only moves when it is told to."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def plain_lines(seconds_each: float, total: int, iterations: Sequence[int], first: int = 0) -> list[str]:
    stream, clock = io.StringIO(), Clock()
    progress = PlainProgress(stream, clock)
    progress.start(total, first)
    for iteration in iterations:
        clock.now += seconds_each
        progress.update(record(iteration))
    progress.close()
    return stream.getvalue().splitlines()


def rows_of(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def write_rows(path: Path, iterations: Sequence[int], first: int = 0) -> None:
    progress = CsvProgress(path)
    progress.start(100, first)
    for iteration in iterations:
        progress.update(record(iteration))
    progress.close()


def test_a_fast_training_prints_a_line_every_five_percent() -> None:
    lines = plain_lines(0.01, 200, range(200))
    assert lines[0] == "training: 200 iterations"
    counts = [int(line.split("/")[0]) for line in lines[1:]]
    assert counts == [*range(1, 200, 10), 200]


def test_a_slow_training_prints_a_line_every_ten_seconds() -> None:
    counts = [int(line.split("/")[0]) for line in plain_lines(4.0, 10_000, range(9))[1:]]
    assert counts == [1, 4, 7, 9]


def test_the_time_left_falls_while_an_iteration_runs() -> None:
    clock = Clock()
    countdown = Countdown(clock)
    countdown.start(100, 0)
    clock.now += 60.0
    countdown.advance(record(0))
    assert countdown.seconds_left == 99 * 60.0
    clock.now += 59.0
    assert countdown.seconds_left == 98 * 60.0 + 1.0
    clock.now += 1e6
    assert countdown.seconds_left == 0.0


def test_an_interrupted_training_prints_its_last_iteration_once() -> None:
    lines = plain_lines(0.01, 100, range(3))
    assert [line.split("/")[0].strip() for line in lines[1:]] == ["1", "3"]


def test_a_line_has_speed_return_success_terminations_and_time_left() -> None:
    line = plain_lines(2.0, 100, [0])[1]
    for part in ("1/100", "20,346 steps/s", "1.50", "71.3 %", "left    3:18", "timeout 75 %, fell 25 %"):
        assert part in line
    assert "target_reached" not in line


def test_time_left_counts_from_the_resume() -> None:
    lines = plain_lines(2.0, 100, [80, 81], first=80)
    assert lines[0] == "training: 100 iterations, resumed at 80"
    assert "left    0:38" in lines[1]


def test_worlds_that_diverged_are_shouted_about() -> None:
    stream = io.StringIO()
    progress = PlainProgress(stream)
    progress.start(10, 0)
    progress.update(record(0, resets_nonfinite=3))
    assert "NON-FINITE WORLDS RESET: 3" in stream.getvalue()


@pytest.mark.parametrize("terminal", [False, True])
def test_before_the_first_episode_ends_nothing_reads_nan(terminal: bool) -> None:
    stream = io.StringIO()
    progress = TerminalProgress("title", stream, force_terminal=True) if terminal else PlainProgress(stream)
    progress.start(10, 0)
    unknown = dict.fromkeys(FIRST.terminations, math.nan)
    progress.update(
        record(
            0, success_rate=math.nan, mean_return=math.nan, mean_episode_steps=math.nan, terminations=unknown
        )
    )
    progress.close()
    assert "1/10" in stream.getvalue()
    assert "nan" not in stream.getvalue()


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0:00"), (59.6, "1:00"), (200, "3:20"), (3909, "1:05:09"), (math.nan, "-")]
)
def test_durations_read_like_a_clock(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_a_rate_that_is_not_known_yet_is_a_dash() -> None:
    assert percent(math.nan) == "-"
    assert percent(1.0) == "100.0 %"
    assert describe_terminations({}) == ""


def test_a_stream_that_is_no_terminal_gets_plain_lines() -> None:
    assert isinstance(console_progress(stream=io.StringIO()), PlainProgress)


def test_a_terminal_gets_one_panel_that_ends_with_the_last_iteration() -> None:
    stream, clock = io.StringIO(), Clock()
    progress = TerminalProgress("mini / baseline", stream, clock, force_terminal=True)
    progress.start(10, 0)
    for iteration in range(4):
        clock.now += 2.0
        progress.update(record(iteration, resets_nonfinite=iteration % 2))
    progress.close()
    progress.close()
    last = stream.getvalue().rsplit("mini / baseline", 1)[1]
    for part in (
        "iteration 4/10",
        "40%, 0:12 left",
        "71.3 %",
        "49,152",
        "timeout 75 %",
        "non-finite state: 2",
    ):
        assert part in last


def test_a_terminal_that_is_closed_before_it_starts_says_nothing() -> None:
    stream = io.StringIO()
    TerminalProgress("title", stream, force_terminal=True).close()
    assert stream.getvalue() == ""


def test_the_table_has_a_column_for_each_figure(tmp_path: Path) -> None:
    write_rows(tmp_path / "progress.csv", range(3))
    rows = rows_of(tmp_path / "progress.csv")
    assert [row["iteration"] for row in rows] == ["0", "1", "2"]
    assert rows[2]["env_steps"] == "36864"
    assert float(rows[2]["termination/fell"]) == 0.25
    assert float(rows[2]["reward/target_distance"]) == 1.0
    assert float(rows[2]["reward_raw/target_distance"]) == 0.004
    assert float(rows[2]["loss/surrogate"]) == -0.01


def test_rows_are_on_disk_before_the_training_ends(tmp_path: Path) -> None:
    progress = CsvProgress(tmp_path / "progress.csv")
    progress.start(10, 0)
    progress.update(FIRST)
    assert rows_of(tmp_path / "progress.csv")[0]["success_rate"] == "nan"
    progress.close()


def test_numpy_integers_keep_every_digit(tmp_path: Path) -> None:
    progress = CsvProgress(tmp_path / "progress.csv")
    progress.start(10, 0)
    progress.update(record(0, env_steps=np.int64(123_456_789)))
    progress.close()
    assert rows_of(tmp_path / "progress.csv")[0]["env_steps"] == "123456789"


def test_a_resumed_table_is_the_table_of_a_run_that_was_never_stopped(tmp_path: Path) -> None:
    write_rows(tmp_path / "whole.csv", range(10))
    write_rows(tmp_path / "resumed.csv", range(7))
    with open(tmp_path / "resumed.csv", "a") as file:
        file.write("7,98304,20")  # a kill in the middle of a row
    write_rows(tmp_path / "resumed.csv", range(4, 10), first=4)
    assert (tmp_path / "resumed.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_a_run_that_starts_anew_drops_the_old_rows(tmp_path: Path) -> None:
    write_rows(tmp_path / "progress.csv", range(7))
    write_rows(tmp_path / "progress.csv", range(2))
    assert [row["iteration"] for row in rows_of(tmp_path / "progress.csv")] == ["0", "1"]


def test_a_figure_that_is_absent_once_leaves_its_cell_empty(tmp_path: Path) -> None:
    progress = CsvProgress(tmp_path / "progress.csv")
    progress.start(10, 0)
    progress.update(FIRST)
    progress.update(record(1, losses={"value": 0.1}))
    progress.close()
    assert rows_of(tmp_path / "progress.csv")[1]["loss/surrogate"] == ""


def test_a_figure_without_a_column_is_an_error(tmp_path: Path) -> None:
    progress = CsvProgress(tmp_path / "progress.csv")
    progress.start(10, 0)
    progress.update(FIRST)
    with pytest.raises(KickbenchError, match="no column for loss/entropy"):
        progress.update(record(1, losses={"entropy": 0.1}))
    progress.close()


@pytest.mark.parametrize("text", ["some other file\n", "iteration,env_steps\n1\n", "iteration\nx\n"])
def test_a_table_that_is_none_of_ours_is_not_touched(tmp_path: Path, text: str) -> None:
    path = tmp_path / "progress.csv"
    path.write_text(text)
    with pytest.raises(KickbenchError, match=r"progress\.csv"):
        CsvProgress(path).start(10, 5)
    assert path.read_text() == text


def test_tensorboard_gets_every_figure_but_not_what_is_unknown(tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    progress = TensorBoardProgress(tmp_path)
    progress.start(10, 0)
    progress.update(FIRST)
    progress.update(record(1))
    progress.close()
    events = accumulator.EventAccumulator(str(tmp_path)).Reload()
    success = events.Scalars("train/success_rate")
    assert [(event.step, event.value) for event in success] == [(1, pytest.approx(0.713))]
    assert [event.step for event in events.Scalars("reward/fall")] == [0, 1]


def test_without_tensorboard_the_training_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard.writer", None)
    progress = TensorBoardProgress(tmp_path)
    progress.start(10, 0)
    progress.update(FIRST)
    progress.close()
    assert capsys.readouterr().err.count("tensorboard is not installed") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_group_closes_every_member_even_when_one_fails() -> None:
    class Member:
        closed = False

        def __init__(self, fails: bool) -> None:
            self.fails = fails

        def start(self, total_iterations: int, first_iteration: int) -> None: ...

        def update(self, record: IterationRecord) -> None: ...

        def close(self) -> None:
            self.closed = True
            if self.fails:
                raise OSError("disk full")

    members = [Member(True), Member(False)]
    with pytest.raises(OSError, match="disk full"):
        ProgressGroup(members).close()
    assert all(member.closed for member in members)


def test_the_usual_set_writes_lines_rows_and_events(tmp_path: Path) -> None:
    stream = io.StringIO()
    progress = standard_progress(tmp_path / "progress.csv", tmp_path / "tensorboard", stream=stream)
    progress.start(2, 0)
    progress.update(FIRST)
    progress.update(record(1))
    progress.close()
    assert "2/2 (100%)" in stream.getvalue()
    assert len(rows_of(tmp_path / "progress.csv")) == 2


def test_importing_progress_loads_nothing_heavy() -> None:
    heavy = ("torch", "rich", "tensorboard", "numpy", "mujoco")
    code = f"import sys, kickbench.training.progress; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_any_flipped_bit_of_a_row_or_of_a_column_name_is_found(tmp_path: Path) -> None:
    path = tmp_path / "progress.csv"
    write_rows(path, range(3))
    whole = path.read_bytes()
    marked = range(whole.index(b",crc32"), whole.index(b"\n") + 1)  # what says that there are checks
    for bit in random.Random(5).sample(range(8 * (len(whole) - 1)), 200):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        if bit // 8 not in marked:
            with pytest.raises(KickbenchError, match=r"progress\.csv:"):
                checked_rows(path)


def test_rows_of_an_older_table_get_their_checks_on_a_resume(tmp_path: Path) -> None:
    path = tmp_path / "progress.csv"
    write_rows(path, range(2))
    whole = path.read_text()
    path.write_text("".join(line.rpartition(",")[0] + "\n" for line in whole.splitlines()))
    assert len(checked_rows(path)) == 3
    write_rows(path, [], first=2)
    assert path.read_text() == whole
