"""The verdicts on the claims of an experiment."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from kickbench.errors import KickbenchError, shown
from kickbench.results.frame import load_runs, runs_of
from kickbench.results.notes import refuse_contradictions, unplanned_lines
from kickbench.results.power import rates_table
from kickbench.results.verdicts import judge, verdict_lines, verdicts_json
from kickbench.trials.experiment import LoadedExperiment, load_experiment


def claims(file: Path, folder: Path | None, *, strict: bool, power: bool, json: bool) -> int:
    """Prints the verdicts; with `strict` the exit code is 1 unless all claims are met."""
    experiment = load_experiment(file)
    if power:
        print(rates_table(experiment))
        return 0
    # Without a folder nothing was measured yet, which is a result; a folder that was typed should be there.
    if folder and not folder.is_dir():
        raise KickbenchError(f"{folder}: no such folder")
    measured = load_runs(folder or measured_folder(experiment), experiment)
    refuse_contradictions(measured, shown)
    verdicts = judge(experiment, measured)
    print(verdicts_json(verdicts) if json else "\n".join(verdict_lines(experiment, verdicts)))
    for line in [*_when_fixed(experiment, measured), *unplanned_lines(measured, shown)]:
        print(line, file=sys.stderr if json else sys.stdout)
    return int(strict and any(verdict.outcome != "met" for verdict in verdicts))


def _when_fixed(experiment: LoadedExperiment, measured: pd.DataFrame) -> list[str]:
    """How many of the runs that count were begun with the claims that they are judged by."""
    runs = runs_of(measured)
    records = [origin.experiment for origin in runs.provenance[runs.counted]]
    these = sum(record is not None and record.claims == experiment.claims_hash for record in records)
    unknown = sum(record is None for record in records)
    counts = {"with these claims": these, "with other claims": len(records) - these - unknown}
    counts["without a record of claims"] = unknown
    said = ", ".join(f"{count} {words}" for words, count in counts.items() if count)
    return [f"{len(records)} runs, begun {said}"] if records else []


def measured_folder(experiment: LoadedExperiment) -> Path:
    """Where the repository keeps the measured runs of an experiment: `results/measured/<experiment>`."""
    return experiment.document.file.parent.parent / "measured" / experiment.name
