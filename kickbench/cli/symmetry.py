"""The verb `symmetry check`: somebody else's mirror function against geometry and physics."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from kickbench.cli import app as cli
from kickbench.errors import KickbenchError


@cli.verb("Define", "symmetry check robot.xml --mirror my_robot.symmetry:mirror", of=cli.symmetry)
def check(
    model: Path = cli.argument("MJCF file, or a robot.yaml.", "MODEL"),
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
        "Period of clocks that --observe reads off data.time, s.", parser=cli.number(0, 1e6), metavar="S"
    ),
) -> int:
    """Prove a hand-written mirror function against geometry and physics; exit code 1 if it is wrong.

    Modules are imported from here or from the Python path: code runs because it is named here.
    """
    if not model.is_file():
        raise KickbenchError(f"{model}: {'a folder, no file' if model.is_dir() else 'no such file'}")
    functions = _function("--mirror", mirror), _function("--observe", observe) if observe else None
    from kickbench.audit.foreign import check_mirror

    report = check_mirror(model, *functions, group=group, period=period)
    print(report)
    return 0 if report else 1


def _function(flag: str, text: str) -> Callable[..., Any]:
    module, _, name = text.partition(":")
    if not module or not name:
        raise KickbenchError(f"{flag} {text}: expected MODULE:FUNCTION")
    sys.path.insert(0, str(Path.cwd()))
    try:
        found = getattr(import_module(module), name, None)
    except Exception as error:  # the module may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise KickbenchError(f"{flag} {text}: cannot be imported: {reason}") from None
    finally:
        sys.path.remove(str(Path.cwd()))
    if not callable(found):
        raise KickbenchError(f"{flag} {text}: the module has no function '{name}'")
    return found
