"""The command line itself: how a verb is added, and the options that several verbs have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import typer
from typer.core import TyperGroup

from kickbench.config.shipped import find, names
from kickbench.errors import SpecError

PANELS = ("Train", "Look at results", "Define", "Check")
_BEGIN = """\
usage: kickbench VERB ...   (kickbench --help lists all verbs, kickbench VERB --help explains one)

Five to begin with:
  kickbench list                                  tasks, methods and robots by name
  kickbench run mini_home_field equivariant       train and evaluate, minutes on a laptop
  kickbench table runs                            what the runs have reached
  kickbench report runs                           the same as a page with pictures
  kickbench show mini_general                     a task, to extend it by one of your own"""


class _Grouped(TyperGroup):
    """Lists the verbs in groups, without rich, whose import takes longer than all the rest of `--help`."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        panels: dict[str, list[tuple[str, str]]] = {panel: [] for panel in PANELS}
        for name, command in self.commands.items():
            panels.setdefault(getattr(command, "rich_help_panel", "") or "Actions", []).append(
                (name, command.help or "")
            )
        for panel, rows in panels.items():
            if rows:
                with formatter.section(panel):
                    formatter.write_dl(rows)


_SETTINGS: dict[str, Any] = {
    "cls": _Grouped,
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"], "max_content_width": 110},
    "subcommand_metavar": "VERB ...",
}
app = typer.Typer(**_SETTINGS)


def _group(name: str, text: str) -> typer.Typer:
    group = typer.Typer(add_completion=False, help=text, **_SETTINGS)
    app.add_typer(group, name=name, rich_help_panel="Define")
    return group


symmetry = _group("symmetry", "Derive joint pairs and signs from a model's geometry; check mirrors.")
robot = _group("robot", "Write a robot file for an MJCF, and check one.")


def verb(
    panel: str, example: str, name: str | None = None, of: typer.Typer = app
) -> Callable[[Callable[..., int | None]], Callable[..., int | None]]:
    """Makes a function a verb: its docstring is the help, its parameters are the arguments.

    It returns its exit code, or nothing for 0. Slow imports belong in the function, since
    every verb is defined whenever one of them is called.

    Args:
        panel: The group in `kickbench --help`.
        example: A call, without `kickbench`.
        name: The verb, if it is not the function's name.
        of: The verb that it belongs to.
    """
    panel_of = panel if of is app else None
    return of.command(name, rich_help_panel=panel_of, epilog=f"Example: kickbench {example}")


@app.callback(invoke_without_command=True)
def _kickbench(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """A declarative benchmark suite for symmetry-aware humanoid RL."""
    if version:
        from kickbench import __version__

        print(f"kickbench {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(_BEGIN, err=True)
        raise typer.Exit(2)


def refuse_contradiction(overrides: Sequence[str], key: str, *values: int | None) -> None:
    """Refuses a flag and a `--set` that give one key two values: one of them would be ignored.

    Args:
        overrides: `key.path=value` texts.
        key: The key; the flag has the name of its last part.
        values: What the flag gives; None or nothing if it is not there.

    Raises:
        SpecError: They differ.
    """
    given = [str(value) for value in values if value is not None]
    flag = f"--{key.rpartition('.')[2].replace('_', '-')} {' '.join(given)}"
    for text in overrides if given else ():
        left, _, right = text.replace(" ", "").partition("=")
        if left == key and {right} != {*given}:
            raise SpecError.of(f"--set {text}", f"{flag} sets {key}, too: give one of them only")


def between(low: float, high: float) -> Callable[[float | None], float | None]:
    """Checks that a number, if it is given, is between two others; NaN is not."""

    def check(value: float | None) -> float | None:
        if value is not None and not low < value < high:
            raise typer.BadParameter(f"expected a number between {low:g} and {high:g}, found {value:g}")
        return value

    return check


class Pixels(NamedTuple):
    """Width and height of a picture."""

    width: int
    height: int


def _size(text: str) -> Pixels:
    sides = text.lower().split("x")
    if len(sides) != 2 or not all(side.isdecimal() and 64 <= int(side) <= 4096 for side in sides):
        raise typer.BadParameter(f"expected WIDTHxHEIGHT, each from 64 to 4096, found {text!r}")
    return Pixels(int(sides[0]), int(sides[1]))


def names_of(*kinds: str) -> Callable[[str], list[str]]:
    """What a shell may complete an argument to: the names of shipped files."""
    return lambda incomplete: [n for kind in kinds for n in names(kind) if n.startswith(incomplete)]


def file_of(*kinds: str) -> dict[str, Any]:
    """Of an argument or option that is a file of some kinds: the verb gets its path, whatever names it."""
    return {"autocompletion": names_of(*kinds), "callback": lambda path: path and find(path, *kinds)}


def argument(text: str, metavar: str, default: Any = ..., **more: Any) -> Any:
    """A positional argument."""
    return typer.Argument(default, help=text, metavar=metavar, show_default=False, **more)


def option(text: str, *flags: str, default: Any = None, **more: Any) -> Any:
    """An option that only one verb has."""
    return typer.Option(default, *flags, help=text, show_default=False, **more)


def flag(text: str, name: str) -> Any:
    """An option without a value."""
    return option(text, name, default=False)


def count(text: str, *flags: str, metavar: str = "N", least: int = 1, **more: Any) -> Any:
    """An option that is a whole number."""
    return option(text, *flags, metavar=metavar, min=least, **more)


FILE: dict[str, Any] = {"exists": True, "dir_okay": False}
FOLDER: dict[str, Any] = {"exists": True, "file_okay": False}
"""Of an argument or option that is a path: it must be there."""
TASK: dict[str, Any] = {"metavar": "TASK", **file_of("task")}
"""Of an argument or option that is a task."""
NONE: list[Any] = []
"""Default of an option that may be repeated."""

# What several verbs have; the default is with the verb.
Task = Annotated[Path, argument("Task: a YAML file or a name of `kickbench list`.", **TASK)]
_METHOD = "Method: a YAML file or a name; of a task's robot."
Method = Annotated[Path, argument(_METHOD, "METHOD", autocompletion=names_of("method"))]
_EXPERIMENT = file_of("experiment")
Experiment = Annotated[Path, argument("Experiment: a YAML file or a name.", "EXPERIMENT", **_EXPERIMENT)]
Run = Annotated[Path, argument("Run directory.", "RUN")]
Policy = Annotated[Path | None, option("Run directory whose policy is used.", default=..., metavar="RUN")]
Roots = Annotated[list[Path], argument("Run directories, or folders of them.", "DIR...")]
_FOR = "Experiment of the runs: file or name."
For = Annotated[Path | None, option(_FOR, default=..., metavar="EXPERIMENT", **_EXPERIMENT)]
Set = Annotated[list[str], option("Override values.", "--set", default=..., metavar="key.path=value")]
Device = Annotated[Literal["cpu", "cuda"], typer.Option(help="Where to compute.")]
Threads = Annotated[int | None, count("Threads (default: the cores this process may use).", default=...)]
Seed = Annotated[int, count("Seed (default: 0).", default=..., least=0, max=2**63 - 1, metavar="K")]
_TASK_SEED = "Seed of the initial states (default: the task's)."
TaskSeed = Annotated[int | None, count(_TASK_SEED, default=..., least=0, max=2**63 - 1, metavar="K")]
Trust = Annotated[bool, option("Run the code that came with the run.", "--trust-code", default=...)]
Json = Annotated[bool, option("Print JSON.", "--json", default=...)]
_SCALE = "Shrink iterations and evaluation episodes (100 a side at least) by this factor; marked in results."
Scale = Annotated[float | None, option(_SCALE, default=..., metavar="S", callback=between(0, 1))]
_SIZE = "Pixels of a picture, 64 to 4096 a side (default: 400x300, films 640x480)."
Size = Annotated[Pixels | None, option(_SIZE, default=..., metavar="WxH", parser=_size)]
