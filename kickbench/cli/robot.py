"""Verbs about a robot: `robot init` and `robot check`."""

from __future__ import annotations

import json as json_text
import sys
from pathlib import Path

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
    from kickbench.robots.check import check_robot

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
