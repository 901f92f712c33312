"""The verb `claims`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from kickbench.errors import KickbenchError, shown
from kickbench.reported import LoadedReported, load_reported
from kickbench.results.frame import load_runs
from kickbench.results.notes import refuse_contradictions, unplanned_lines
from kickbench.results.verdict_file import verdicts_json
from kickbench.results.verdicts import judge, verdict_lines


def claims(arguments: argparse.Namespace) -> int:
    """`kickbench claims EXPERIMENT [DIR]`: the verdicts; with `--strict` exit code 1 unless all are met."""
    experiment = load_reported(arguments.experiment)
    folder = arguments.folder or measured_folder(experiment)
    # Without a folder nothing was measured yet, which is a result; a folder that was typed should be there.
    if arguments.folder and not folder.is_dir():
        raise KickbenchError(f"{folder}: no such folder")
    measured = load_runs(folder, experiment)
    refuse_contradictions(measured, shown)
    verdicts = judge(experiment, measured)
    print(verdicts_json(verdicts) if arguments.json else "\n".join(verdict_lines(experiment, verdicts)))
    for line in unplanned_lines(measured, shown):
        print(line, file=sys.stderr if arguments.json else sys.stdout)
    return int(arguments.strict and any(verdict.outcome != "met" for verdict in verdicts))


def measured_folder(experiment: LoadedReported) -> Path:
    """Where the repository keeps the measured runs of an experiment: `results/measured/<experiment>`."""
    return experiment.document.file.parent.parent / "measured" / experiment.name
