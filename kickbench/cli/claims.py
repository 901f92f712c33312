"""The verb `claims`."""

from __future__ import annotations

import argparse
from pathlib import Path

from kickbench.errors import KickbenchError, shown
from kickbench.reported import LoadedReported, load_reported
from kickbench.results.measured import read_measured
from kickbench.results.verdicts import judge, verdict_lines


def claims(arguments: argparse.Namespace) -> int:
    """`kickbench claims EXPERIMENT [DIR]`: the verdicts; with `--strict` exit code 1 unless all are met."""
    experiment = load_reported(arguments.experiment)
    folder = arguments.folder or measured_folder(experiment)
    # Without a folder nothing was measured yet, which is a result; a folder that was typed should be there.
    if arguments.folder and not folder.is_dir():
        raise KickbenchError(f"{folder}: no such folder")
    measured = read_measured(folder, experiment)
    verdicts = judge(experiment, measured)
    print("\n".join(verdict_lines(experiment, verdicts)))
    for path in measured.strangers:
        print(f"not planned by {experiment.name}, left out: {shown(path)}")
    return int(arguments.strict and any(verdict.outcome != "met" for verdict in verdicts))


def measured_folder(experiment: LoadedReported) -> Path:
    """Where the repository keeps the measured runs of an experiment: `results/measured/<experiment>`."""
    return experiment.document.file.parent.parent / "measured" / experiment.name
