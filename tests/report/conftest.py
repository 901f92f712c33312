"""Run directories with known figures, written with the functions that write real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kickbench.results.episode_table import EpisodeSides, EpisodeTable, episode_table, write_episodes
from kickbench.results.metrics import Metrics
from kickbench.results.summary import summarise_sides

from ..made_up import made_up_metrics, write_result

COMMIT = "0123456789abcdef0123456789abcdef01234567"


def make_table(episodes: int = 60, seed: int = 0) -> EpisodeTable:
    """Balls on the left; every third target is missed; the left foot kicks where the ball is far to the left."""
    rng = np.random.default_rng(seed)
    ball_y, angle = rng.uniform(0.02, 0.3, episodes), rng.uniform(0.05, 0.8, episodes)
    reach, hit = rng.uniform(1.0, 2.0, episodes), np.arange(episodes) % 3 != 0
    target = np.stack([reach * np.cos(angle), reach * np.sin(angle)])
    distance = np.where(hit, 0.2, 0.8)
    return episode_table(
        start_ball_x=rng.uniform(0.25, 0.55, episodes),
        start_ball_y=ball_y,
        target_x=target[0],
        target_y=target[1],
        final_ball_x=target[0] - distance,
        final_ball_y=target[1],
        distance=distance,
        success=hit,
        termination=np.where(hit, "target_hit", "target_missed"),
        steps=np.full(episodes, 70),
        episode_return=np.where(hit, 4.0, 1.0),
        kick_foot=np.where(ball_y > 0.15, "left", "right"),
        kick_step=np.full(episodes, 20),
        peak_ball_speed=np.full(episodes, 2.0),
        touches=np.full(episodes, 1),
        walked_after_touch=np.full(episodes, 0.25),
        launch_speed=np.full(episodes, 1.75),
        direction_error=np.where(hit, 0.0, -0.75),
    )


def mirror(table: EpisodeTable) -> EpisodeTable:
    """The episodes of a policy that treats both sides equally."""
    feet = {"left": "right", "right": "left"}
    return table.assign(
        start_ball_y=-table.start_ball_y,
        target_y=-table.target_y,
        final_ball_y=-table.final_ball_y,
        kick_foot=table.kick_foot.map(feet),
        direction_error=-table.direction_error,
    )


def make_metrics(sides: EpisodeSides, task: str, method: str, seed: int, **changes: object) -> Metrics:
    source = {
        "versions": {"python": "3.11.7", "mujoco": "4.0.0"},
        "device": "A Processor",
        "commit": COMMIT,
        "dirty": False,
        "finished": "2026-01-01T01:30:00+00:00",
        "seconds": 5400.0,
    }
    values = {"iterations": 450, "env_steps": 2_764_800, "training_seconds": 5000.0, **changes}
    evaluation = summarise_sides(sides, 0.02)
    return made_up_metrics(evaluation, source, task=task, method=method, seed=seed, **values)


def progress_text(iterations: int, offset: float = 0.0) -> str:
    """A progress table whose return is the iteration plus an offset; the first row knows nothing yet."""
    names = "iteration,mean_return,termination/target_hit,termination/target_missed"
    rows = [
        f"{i},{i + offset},{i / 1000},{1 - i / 1000}" if i else "0,nan,nan,nan" for i in range(iterations)
    ]
    return "\n".join([names, *rows]) + "\n"


class Folder:
    """A folder of runs to be."""

    def __init__(self, path: Path, task: str = "mini_home_field") -> None:
        self.path, self.task = path, task

    def add(
        self,
        method: str,
        seed: int = 0,
        *,
        curves: int | None = 450,
        table: bool = True,
        identity=None,
        **changes,
    ) -> Path:
        """A finished run; `curves`: iterations of its progress table, `table`: whether it keeps its episodes."""
        home = make_table(seed=seed)
        sides, run = EpisodeSides(home, mirror(home)), self.path / method / f"seed{seed}"
        run.mkdir(parents=True)
        if curves is not None:
            (run / "progress.csv").write_text(progress_text(curves, 10.0 * seed))
        if table:
            write_episodes(run / "episodes.csv", sides)
        metrics = make_metrics(sides, self.task, method, seed, **changes)
        write_result(run, metrics, identity)
        return run


@pytest.fixture(scope="session")
def make_folder(tmp_path_factory):
    """Makes folders of runs that several tests share: `make_folder()`."""

    def make() -> Folder:
        path = tmp_path_factory.mktemp("runs") / "mini_home_field"
        path.mkdir()
        return Folder(path)

    return make


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    """An empty folder of runs, named after the task."""
    path = tmp_path / "mini_home_field"
    path.mkdir()
    return Folder(path)
