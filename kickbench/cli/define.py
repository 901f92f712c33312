"""Verbs for the YAML files: `list`, `new`, `show`, `validate`, `terms` and `schema`."""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from kickbench.cli import app as cli
from kickbench.config.shipped import FOLDERS, find, find_method, names
from kickbench.errors import KickbenchError, Problem, SpecError, printable, shown

Kind = Literal["task", "method", "robot", "representations", "experiment", "reported"]
Terms = Literal["observations", "rewards", "terminations", "randomizations"]
_NAMES = cli.names_of(*FOLDERS)


class _TorchLater:
    """Stands for torch until something of it is used: importing it takes twice as long as checking a task."""

    __spec__ = None  # looked at by `import torch`

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get("torch") is self:
            del sys.modules["torch"]
        return getattr(import_module("torch"), name)


@cli.verb("Define", "list", name="list")
def list_files() -> None:
    """List the tasks, methods, robots, representation tables and experiments that have names."""
    from kickbench.config.yamlio import load_document

    for kind in FOLDERS:
        texts = {name: load_document(path).data.get("description", "") for name, path in names(kind).items()}
        width = max(map(len, texts))
        lines = (f"  {name:<{width}}  {printable(str(text))}".rstrip() for name, text in texts.items())
        print("\n".join([f"{kind}:", *lines]))


@cli.verb("Define", "new task my_task --from mini_general")
def new(
    kind: Literal["task", "method"] = cli.argument("What to define.", "KIND"),
    name: str = cli.argument("Its name; the file is NAME.yaml.", "NAME"),
    base: Path = cli.option("What it extends: a YAML file or a name.", "--from", metavar="BASE", default=...),
) -> None:
    """Write a YAML file that extends another one, with every value as a comment to edit."""
    from kickbench.config.yamlio import load_document
    from kickbench.config.yamltree import dump_yaml
    from kickbench.results.atomic import atomic_write_text

    if Path(name).name in ("", ".."):
        raise KickbenchError(f"'{name}' is no name of a file")
    file, out = find(base, kind).absolute(), Path(name).with_suffix(".yaml")
    if out.exists():
        raise KickbenchError(f"{shown(out)}: is there already")
    data = load_document(file).data
    rest = {
        key: value for key, value in data.items() if key not in ("description", "robot", "representations")
    }
    place = os.path.relpath(file, out.parent) if file.is_relative_to(Path.cwd()) else file
    text = "".join(f"# {line}\n" for line in dump_yaml(rest).splitlines())
    head = f"# A {kind} like {base}. Remove the `#` of what is to differ, and of the keys above it.\n"
    own = dump_yaml({"extends": str(place), "description": f"{out.stem}: {data.get('description', '')}"})
    atomic_write_text(out, f"{head}{own}\n{text}")
    print(shown(out))


@cli.verb("Define", "validate my_task.yaml mini/equivariant")
def validate(
    files: list[Path] = cli.argument("YAML files of any kind, or names.", "FILE...", autocompletion=_NAMES),
    overrides: cli.Set = cli.NONE,
) -> None:
    """Check YAML files, a single task with every method among them, and report all errors."""
    paths = [find(file, *FOLDERS) for file in files]
    sys.modules.setdefault("torch", _TorchLater())  # type: ignore[arg-type]
    from kickbench.trials.validate import check_files

    problems: list[Problem] = []
    for report in check_files(paths, overrides):
        problems += report.problems
        if report.kind and not report.problems:
            print(f"{shown(report.name)}: fine ({report.kind})")
        for note in report.notes:
            print(f"{shown(report.name)}: note: {printable(note)}")
    if problems:
        raise SpecError(problems)


@cli.verb("Define", "show mini_home_field --set ball.mass=0.2")
def show(
    file: Path = cli.argument("A YAML file of any kind, or a name.", "FILE", **cli.file_of(*FOLDERS)),
    fields: Path | None = cli.option("Print how all mirrors by this method instead.", metavar="METHOD"),
    overrides: cli.Set = cli.NONE,
) -> None:
    """Print a resolved spec and where each value came from."""
    if fields is not None:
        return _show_fields(file, find_method(fields, file, overrides), overrides)
    from kickbench.config.explain import explain
    from kickbench.config.load import load
    from kickbench.config.yamlio import load_document
    from kickbench.envs.catalog import model_of_task
    from kickbench.trials.validate import kind_of, model_of

    kind = kind_of(load_document(file, overrides))
    loaded = load(model_of_task if kind == "task" else model_of(kind), file, overrides)
    print(explain(loaded.spec, loaded.document).rstrip("\n"))


@cli.verb("Define", "terms rewards")
def terms(
    kind: Terms | None = cli.argument("Of this kind only.", "[KIND]", default=None),
    own: Path | None = cli.option("With those of one's own Python file.", metavar="FILE", **cli.FILE),
) -> None:
    """List all terms with parameters, units and source."""
    from kickbench.envs.catalog import catalog
    from kickbench.envs.term import describe_common

    last = None
    for term in (term for table in catalog(own).values() for term in table.values()):
        if kind in (None, f"{term.kind}s"):
            if term.kind != last:
                print(f"{term.kind}s\n{'-' * (len(term.kind) + 1)}")
                if common := describe_common(term.kind):
                    print(f"every {term.kind} accepts\n{common}\n")
            last = term.kind
            print(term.describe())


@cli.verb("Define", "schema task")
def schema(kind: Kind = cli.argument("Kind of file.", "KIND")) -> None:
    """Print the JSON Schema of a kind of file."""
    from kickbench.config.explain import json_schema
    from kickbench.trials.validate import model_of

    print(json.dumps(json_schema(model_of(kind)), indent=2))


def _show_fields(task: Path, method: Path, overrides: list[str]) -> None:
    """Prints field tables, and how the actions mirror."""
    from kickbench.trials.trial import load_trial

    experiment = load_trial(task, method, overrides)
    symmetry, names = experiment.symmetry, experiment.task.scene.layout.actuator_names
    parts = [f"observations: {group}\n{table}" for group, table in symmetry.groups.items()]
    parts.append("\n".join((f"actions: {symmetry.actions}", *symmetry.actions.describe(names))))
    print("\n\n".join(parts))
