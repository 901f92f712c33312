"""`kickbench report DIR`: from a folder of runs to the file of a page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kickbench import __version__
from kickbench.errors import KickbenchError, printable
from kickbench.report.headline import Claimed, claimed
from kickbench.report.page import anchors, part_of, render
from kickbench.report.study import studies
from kickbench.results.atomic import atomic_write_text
from kickbench.results.frame import load_runs
from kickbench.results.notes import refuse_contradictions
from kickbench.results.provenance import code_state
from kickbench.results.verdicts import judge
from kickbench.trials.experiment import LoadedExperiment


def write_report(root: Path, out: Path, experiment: LoadedExperiment | None = None) -> None:
    """Writes the page of a folder of runs.

    Args:
        root: The folder.
        out: File to write.
        experiment: What should be there; default: whatever is there.

    Raises:
        KickbenchError: There is no run, or a library is missing.
    """
    found = studies(root, experiment)
    claims: tuple[Claimed, ...] = ()
    if experiment is not None:
        claims, problems = judged(root, experiment)
        found = tuple(replace(study, problems=(*study.problems, *problems)) for study in found)
    parts = [
        part_of(study, claims, anchor, code_state()[0])
        for study, anchor in zip(found, anchors(found), strict=True)
    ]
    title = f"kickbench: {found[0].name if len(found) == 1 else root.resolve().name}"
    atomic_write_text(out, printable(render(title, parts, _made_by())))


def judged(root: Path, experiment: LoadedExperiment) -> tuple[tuple[Claimed, ...], tuple[str, ...]]:
    """The claims of an experiment with their verdicts; and, where they cannot be judged, why not."""
    try:
        runs = load_runs(root, experiment)
        refuse_contradictions(runs, str)
        verdicts = judge(experiment, runs)
    except KickbenchError as error:
        return (), (f"The claims cannot be judged: {error}".replace(f"{root}/", ""),)
    return tuple(map(claimed, verdicts)), ()


def _made_by() -> str:
    commit, dirty = code_state()
    at = f" at commit {commit[:10]}{' with uncommitted changes' if dirty else ''}" if commit else ""
    return f"Page made by kickbench {__version__}{at}."
