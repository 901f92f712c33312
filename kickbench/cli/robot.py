"""Verbs about a robot: `robot init` and `check`; `symmetry derive`, and `check` for a mirror function."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from kickbench.cli import app as cli
from kickbench.errors import KickbenchError, printable, shown

_PORTRAIT = (300, 400)


@cli.verb("Define", "robot init my_robot.xml -o assets/my_robot/robot.yaml", of=cli.robot)
def init(
    model: Path = cli.argument("MJCF file.", "MODEL", **cli.FILE),
    out: Path = cli.option("File (default: robot.yaml).", "-o", "--out", default=Path("robot.yaml")),
) -> int:
    """Write a robot file for an MJCF, with comments on all that is guessed, and validate it."""
    if out.exists():
        raise KickbenchError(f"{shown(out)}: is there already")
    from kickbench.results.atomic import atomic_write_text
    from kickbench.robots.write import robot_file
    from kickbench.trials.validate import check_files

    text = robot_file(model, out)
    atomic_write_text(out, text)
    (report,) = check_files([out])
    guesses = sum("GUESS" in line for line in text.splitlines())
    print(f"{shown(out)}: written, {guesses} lines with a guess; next: kickbench robot check {shown(out)}")
    for line in [*map(str, report.problems), *report.notes]:
        print(f"left to you: {printable(line)}")
    return 1 if report.problems else 0


@cli.verb("Define", "robot check booster_k1 -o k1.png", of=cli.robot)
def check(
    robot: Path = cli.argument("Robot: a YAML file or a name.", "ROBOT", **cli.file_of("robot")),
    out: Path | None = cli.option("Draw how it starts and ends (.png).", "-o", "--out", metavar="FILE"),
    task: Path = cli.option(
        "Task whose scene is used (default: mini_general).", default=Path("mini_general")
    ),
    size: cli.Size = None,
    json: cli.Json = False,
) -> int:
    """Print what to know of a robot before it is trained; exit code 1 if a fact fails."""
    from kickbench.robots.facts import check_robot

    report = check_robot(robot.absolute(), task)
    print(json_text.dumps(report.as_json(), indent=2) if json else "\n".join(report.lines()))
    if out is not None:
        from kickbench.results.atomic import atomic_file
        from kickbench.view.pictures import robot_picture

        picture = robot_picture(report.task, report.poses, report.box, *(size or _PORTRAIT))
        with atomic_file(out) as file:
            picture.save(file, "PNG")
        print(shown(out), file=sys.stderr if json else sys.stdout)
    return int(report.failed)


@cli.verb("Define", "symmetry derive my_robot.xml", of=cli.symmetry)
def derive(model: Path = cli.argument("MJCF file.", "MODEL", **cli.FILE)) -> int:
    """Print the `symmetry:` block of a robot file, derived from the geometry of its MJCF."""
    from kickbench.sim.carried import compile_robot
    from kickbench.sim.read_parts import read_parts
    from kickbench.symmetry.derive import derive, symmetry_block

    derivation = derive(read_parts(compile_robot(model)))
    print(symmetry_block(derivation, model.name))
    return 1 if derivation.unclear else 0


@cli.verb("Define", "symmetry check robot.xml --mirror my_robot.symmetry:mirror", "check", of=cli.symmetry)
def check_mirror(
    model: Path = cli.argument("MJCF file, or a robot.yaml.", "MODEL", **cli.FILE),
    mirror: str = cli.option(
        "Function (env, obs, actions) -> (obs, actions), as rsl_rl's symmetry extension takes it.",
        metavar="MODULE:FUNCTION",
        default=...,
    ),
    observe: str | None = cli.option(
        "Function (model, data) -> observations of a physical state.", metavar="MODULE:FUNCTION"
    ),
    group: str = cli.option("Observation group (default: policy).", default="policy", metavar="NAME"),
    period: float | None = cli.option(
        "Period of clocks that --observe reads off data.time, s.", callback=cli.between(0, 1e6), metavar="S"
    ),
) -> int:
    """Prove a hand-written mirror function against geometry and physics; exit code 1 if it is wrong.

    Modules are imported from here or from the Python path: code runs because it is named here.
    """
    functions = _function("--mirror", mirror), _function("--observe", observe) if observe else None
    from kickbench.audit.foreign import check_mirror as check

    report = check(model, *functions, group=group, period=period)
    print(report)
    return 0 if report else 1


def _function(flag: str, text: str) -> Callable[..., Any]:
    sys.path.insert(0, str(Path.cwd()))
    try:
        found = resolve_name(text)
    except Exception as error:  # the module may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise KickbenchError(f"{flag} {text}: cannot be imported: {reason}") from None
    finally:
        sys.path.remove(str(Path.cwd()))
    if not callable(found):
        raise KickbenchError(f"{flag} {text}: expected MODULE:FUNCTION")
    return found
