"""Verbs about a robot: `robot init` and `robot check`."""

from __future__ import annotations

from pathlib import Path

from kickbench.cli import app as cli
from kickbench.errors import KickbenchError, printable, shown


@cli.verb("Define", "robot init my_robot.xml -o assets/my_robot/robot.yaml", of=cli.robot)
def init(
    model: Path = cli.argument("MJCF file.", "MODEL"),
    out: Path = cli.option(
        "File to write (default: robot.yaml).", "-o", "--out", metavar="FILE", default=Path("robot.yaml")
    ),
) -> int:
    """Write a robot file for an MJCF, with comments on all that is guessed, and validate it."""
    if not model.is_file():
        raise KickbenchError(f"{model}: {'a folder, no file' if model.is_dir() else 'no such file'}")
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
