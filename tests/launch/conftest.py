"""Run directories in every state, made by hand; an experiment of seconds."""

from __future__ import annotations

import io
from pathlib import Path
from zipfile import ZipFile

import pytest

from kickbench.results.atomic import atomic_write_bytes, atomic_write_text
from kickbench.results.episode_table import EpisodeSides, EpisodeTable, episode_table
from kickbench.results.metrics import Metrics
from kickbench.results.store import RunDirectory
from kickbench.results.summary import summarise_sides
from kickbench.trials.experiment import LoadedExperiment, load_experiment

from ..made_up import made_up_metrics, write_result
from ..support import SMALL

ROOT = Path(__file__).parents[2]
TINY = (*SMALL, "episode.max_steps=20")
HEADER = "iteration,steps_per_second,success_rate,collect_seconds,update_seconds"


def episodes(successes: int, count: int = 10) -> EpisodeTable:
    import numpy as np

    numbers, zeros = np.arange(count), np.zeros(count)
    success = numbers < successes
    return episode_table(
        start_ball_x=zeros + 0.3,
        start_ball_y=np.where(numbers % 2, 0.1, -0.1),
        target_x=zeros + 1.5,
        target_y=zeros,
        final_ball_x=zeros + 1.5,
        final_ball_y=zeros,
        distance=np.where(success, 0.1, 1.0),
        success=success,
        termination=np.where(success, "target_hit", "time_out"),
        steps=numbers + 10,
        episode_return=zeros,
        kick_foot=np.full(count, "left"),
        kick_step=numbers,
        peak_ball_speed=zeros + 1,
        touches=numbers,
        walked_after_touch=zeros,
        launch_speed=zeros + 1,
        direction_error=zeros,
    )


def make_metrics(iterations: int, seconds: float = 100.0, **values) -> Metrics:
    """A result with 4 of 10 successes; `seconds` of training and 20 s of evaluation."""
    evaluation = summarise_sides(EpisodeSides(episodes(4), None), 0.02)
    return made_up_metrics(evaluation, iterations=iterations, training_seconds=seconds, **values)


def checkpoint(numbers: bytes = b"numbers") -> bytes:
    """A file as whole as a checkpoint."""
    file = io.BytesIO()
    with ZipFile(file, "w") as archive:
        archive.writestr("data", numbers * 100)
    return file.getvalue()


@pytest.fixture
def make_run(tmp_path):
    """`make_run(name, rows=..., checkpoints=..., finished=...)` makes a run directory."""

    def make(
        name: str = "run", rows: int = 0, checkpoints: tuple[int, ...] = (), finished: int | None = None
    ) -> RunDirectory:
        directory = RunDirectory(Path(tmp_path, name))
        if rows:
            lines = [f"{i},{100 + i},{i / 1000},1.5,0.5" for i in range(rows)]
            atomic_write_text(directory.progress, "\n".join([HEADER, *lines]) + "\n")
        for iteration in checkpoints:
            atomic_write_bytes(directory.checkpoints / f"iteration_{iteration:06d}.pt", checkpoint())
        if finished is not None:
            write_result(directory.path, make_metrics(finished))
        return directory

    return make


def tiny_experiment(folder: Path, conditions: str, iterations: int, *transfer: str) -> LoadedExperiment:
    """An experiment on the mini kicker for `--set` of `TINY`; METHODS stands for the mini methods' folder."""
    file, tasks = folder / "tiny.yaml", f"{ROOT}/tasks"
    also = ", ".join(f"{tasks}/{name}.yaml" for name in transfer)
    file.write_text(
        f"task: {tasks}/mini_home_field.yaml\nseeds: [0]\niterations: {iterations}\n"
        f"evaluation: {{episodes: 20, transfer: [{also}]}}\n"
        f"conditions:{conditions.replace('METHODS', f'{ROOT}/methods/mini')}"
    )
    return load_experiment(file)
