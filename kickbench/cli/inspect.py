"""Verbs that look at files: `validate`, `show`, `schema`, `terms`, `list`, `table` and `compare`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from kickbench.errors import KickbenchError, Problem, SpecError, printable, shown
from kickbench.results.kick_table import kick_block
from kickbench.results.metrics import load_metrics
from kickbench.results.store import RunDirectory, find_results
from kickbench.results.table import render_table
from kickbench.speccheck import KINDS, check_files, kind_of, model_of


def validate(arguments: argparse.Namespace) -> int:
    """`kickbench validate FILE...`: every file, a single task with every method, every error."""
    problems: list[Problem] = []
    for report in check_files(arguments.files, arguments.overrides):
        problems += report.problems
        if report.kind and not report.problems:
            print(f"{shown(report.name)}: fine ({report.kind})")
        for note in report.notes:
            print(f"{shown(report.name)}: note: {printable(note)}")
    if problems:
        raise SpecError(problems)
    return 0


def show(arguments: argparse.Namespace) -> int:
    """`kickbench show FILE`: the resolved spec and where each value came from."""
    from kickbench.spec.explain import explain
    from kickbench.spec.load import load
    from kickbench.yamlio import load_document

    kind = kind_of(load_document(arguments.file, arguments.overrides))
    loaded = load(model_of(kind), arguments.file, arguments.overrides)
    print(explain(loaded.spec, loaded.document).rstrip("\n"))
    return 0


def show_fields(arguments: argparse.Namespace) -> int:
    """`kickbench show TASK --fields METHOD`: field tables, and the actions in both bases."""
    from kickbench.experiment import load_experiment

    experiment = load_experiment(arguments.file, arguments.method, arguments.overrides)
    symmetry, names = experiment.symmetry, experiment.task.scene.layout.actuator_names
    parts = [f"observations: {group}\n{table}" for group, table in symmetry.groups.items()]
    parts.append("\n".join((f"actions: {symmetry.actions}", *symmetry.actions.describe(names))))
    parts.append("\n".join(("actions, isotypic form", *symmetry.actions.describe_isotypic(names))))
    print("\n\n".join(parts))
    return 0


def schema(arguments: argparse.Namespace) -> int:
    """`kickbench schema KIND`: JSON Schema for editors."""
    from kickbench.spec.json_schema import json_schema

    print(json.dumps(json_schema(model_of(arguments.kind)), indent=2))
    return 0


def terms(arguments: argparse.Namespace) -> int:
    """`kickbench terms`: every observation, reward, termination and randomisation."""
    from kickbench.mdp.catalog import catalog
    from kickbench.mdp.describe import describe, describe_common

    kind = None
    for term in catalog().all():
        if term.kind != kind:
            kind = term.kind
            print(f"{kind}s\n{'-' * (len(kind) + 1)}")
            if common := describe_common(kind):
                print(f"every {kind} accepts\n{common}\n")
        print(describe(term))
    return 0


def list_files(arguments: argparse.Namespace) -> int:
    """`kickbench list`: tasks, methods, robots, experiments and finished runs below a folder."""
    root = arguments.root
    if not root.is_dir():
        raise KickbenchError(f"{root}: no such folder")
    found = sorted(_specs(root))
    for kind in KINDS:
        entries = [(path, text) for found_kind, path, text in found if found_kind == kind]
        if entries:
            width = max(len(shown(path)) for path, _ in entries)
            print(f"{kind}:")
            print(
                "\n".join(f"  {shown(path):<{width}}  {printable(text)}".rstrip() for path, text in entries)
            )
    runs = _undamaged(find_results(root))
    if runs:
        print("finished runs:\n" + "\n".join(f"  {shown(run.path)}" for run in runs))
    return 0


def _specs(root: Path) -> Iterator[tuple[str, Path, str]]:
    from kickbench.yamlio import load_document

    folders = {
        "tasks/**/*.yaml": "task",
        "methods/**/*.yaml": "method",
        "assets/*/*.yaml": "robot",
        "results/reported/*.yaml": "reported",
    }
    for pattern, usual in folders.items():
        for path in root.glob(pattern):
            try:
                document = load_document(path)
                kind = kind_of(document)
            except SpecError as error:
                yield usual, path, f"does not load: {error.problems[0]}"
                continue
            yield kind, path, str(document.data.get("description", ""))


def table(arguments: argparse.Namespace) -> int:
    """`kickbench table DIR...`: the table of finished runs."""
    runs = [load_metrics(run.metrics) for run in _finished_runs(arguments.roots)]
    if arguments.columns == "kick":
        tasks = dict.fromkeys(run.task for run in runs)
        print("\n\n".join(kick_block(task, [run for run in runs if run.task == task]) for task in tasks))
    else:
        print(render_table(runs))
    return 0


def compare(arguments: argparse.Namespace) -> int:
    """`kickbench compare DIR...`: every method against every other."""
    from kickbench.results.comparison_table import render_comparison
    from kickbench.results.figures_compared import gather

    print(render_comparison(gather(_finished_runs(arguments.roots))))
    return 0


def _finished_runs(roots: Sequence[Path]) -> list[RunDirectory]:
    """The finished runs of some folders, each once however many of the folders it is in.

    Raises:
        KickbenchError: A folder has none: its name may be misspelt.
    """
    below = {root: _undamaged(find_results(root)) for root in dict.fromkeys(roots)}
    empty = [str(root) for root, runs in below.items() if not runs]
    if empty:
        raise KickbenchError(f"no finished run in {', '.join(empty)}")
    found: dict[Path, RunDirectory] = {}
    for run in (run for runs in below.values() for run in runs):
        found.setdefault(run.path.resolve(), run)
    return list(found.values())


def _undamaged(results: Sequence[RunDirectory]) -> list[RunDirectory]:
    """The runs whose result can be read; the others are told, as they are not counted."""
    damage = {run: run.damage for run in results}
    for told in filter(None, damage.values()):
        print(f"left out: {printable(told)}", file=sys.stderr)
    return [run for run in results if damage[run] is None]
