"""Verbs that look at files: `validate`, `show`, `schema`, `terms`, `list`, `table` and `compare`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kickbench.errors import KickbenchError, Problem, SpecError, printable, shown
from kickbench.speccheck import KINDS, check_files, kind_of, model_of

if TYPE_CHECKING:
    import pandas as pd


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
    from kickbench.mdp.catalog import model_of_task

    model = model_of_task if kind == "task" else model_of(kind)
    loaded = load(model, arguments.file, arguments.overrides)
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
    _print_runs(root)
    return 0


def _print_runs(root: Path) -> None:
    from kickbench.results.frame import load_runs, runs_of
    from kickbench.results.notes import left_out_lines, repeat_lines

    runs = load_runs(root)
    finished = runs_of(runs[runs.state == "finished"])
    if len(finished):
        print("finished runs:\n" + "\n".join(f"  {path}" for path in finished.path))
    lines = [*repeat_lines(runs, shown), *left_out_lines(runs, shown)]
    if lines:
        print("\n".join(lines))


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
    from kickbench.results.kick_table import render_kicks
    from kickbench.results.table import render_table

    render = render_kicks if arguments.columns == "kick" else render_table
    print(render(_runs(arguments.roots)))
    return 0


def compare(arguments: argparse.Namespace) -> int:
    """`kickbench compare DIR...`: every method against every other."""
    from kickbench.results.comparison_table import render_comparison
    from kickbench.results.notes import refuse_contradictions

    runs = _runs(arguments.roots)
    refuse_contradictions(runs, shown)
    print(render_comparison(runs))
    return 0


def _runs(roots: Sequence[Path]) -> pd.DataFrame:
    """The runs of some folders, each once however many of the folders it is in.

    Raises:
        KickbenchError: A folder has no finished run: its name may be misspelt. Says what is there instead.
    """
    from kickbench.results.frame import load_runs
    from kickbench.results.notes import left_out_lines

    runs = load_runs(roots)
    finished = [path.resolve() for path in runs.path[runs.state == "finished"]]
    empty = [
        str(root)
        for root in dict.fromkeys(roots)
        if not any(path.is_relative_to(root.resolve()) for path in finished)
    ]
    if empty:
        lines = [*left_out_lines(runs, shown), f"no finished run in {', '.join(empty)}"]
        raise KickbenchError("\n".join(lines))
    return runs
