"""What a film shows: the policies of runs, in episodes of a task's evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kickbench.envs.compile import CompiledTask
from kickbench.evaluation.episodes import Policy, mirror_starts
from kickbench.evaluation.progress import tracked
from kickbench.results.metrics import load_metrics
from kickbench.results.store import RunDirectory
from kickbench.training.trained import load_run
from kickbench.view.recording import fitting, record_episodes
from kickbench.view.starts import evaluation_starts
from kickbench.view.video import Take, check_mp4, film, frame_time, write_mp4, write_webp


def film_runs(
    task: CompiledTask,
    runs: Sequence[Path],
    out: Path,
    episodes: int,
    seed: int,
    size: tuple[int, int],
    *,
    mirrored: bool = False,
) -> None:
    """Films the first episodes of a task's evaluation, in real time.

    Args:
        task: The task.
        runs: Run directories, whose policies are shown side by side; none: zero action.
        out: File to write, .webp or .mp4.
        episodes: Number of episodes.
        seed: Seed of the starts.
        size: Width and height of one policy's part, pixels.
        mirrored: Whether to show the mirror images of the starts.

    Raises:
        KickbenchError: There is no OpenGL, a library is missing, or a run has no policy for the task.
    """
    is_mp4 = out.suffix.lower() == ".mp4"
    if is_mp4:
        check_mp4(*size)
    starts, policies = evaluation_starts(task, episodes, seed), list[tuple[str, Policy | None]]()
    if mirrored:
        starts = mirror_starts(task, starts)
    for run in runs:
        policies.append((_title(run, runs), fitting(task, load_run(run, unfinished=True))))
    takes = [
        Take(title, record_episodes(task, policy, starts, seed)) for title, policy in policies or [("", None)]
    ]
    frames = tracked(film(task, takes, *size, mirrored=mirrored), "drawing", "frames")
    (write_mp4 if is_mp4 else write_webp)(out, frames, frame_time(task))


def _title(run: Path, runs: Sequence[Path]) -> str:
    """The method, where several are compared."""
    file = RunDirectory(run).metrics
    return (load_metrics(file).method if file.is_file() else run.name) if len(runs) > 1 else ""
