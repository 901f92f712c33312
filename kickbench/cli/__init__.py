"""The command line: parse, call, report faults. Verbs import what they need when they are called."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import Any

from kickbench.cli.faults import fault_message, mute, report_fault
from kickbench.errors import KickbenchError

_VERBS = ("train", "look", "define", "check")
"""Modules with verbs."""
_LISTS = {"reproduce": "--seeds", "bench": "--num-envs"}
"""Options that take several numbers at once."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: Arguments without the program's name; default: the process's.

    Returns:
        Exit code: 0 fine, 1 a check or the system failed, 2 a wrong specification, 130 interrupted.

    Raises:
        SystemExit: Wrong usage (2), or help was asked for (0).
    """
    for stream in (sys.stdout, sys.stderr):
        # Names of files may hold bytes that are not UTF-8.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        code = _call(_spread(list(sys.argv[1:] if argv is None else argv)))
        if sys.stdout is not None:
            sys.stdout.flush()  # while there is still someone to handle a full disk
        return code
    except KeyboardInterrupt:
        report_fault("interrupted")
        return 130
    except BrokenPipeError:
        # The reader of our output has gone (`kickbench show ... | head`).
        mute(sys.stdout, sys.stderr)
        return 1
    except Exception as error:
        message = fault_message(error)
        if message is None:
            raise
        mute(sys.stdout)
        report_fault(message)
        return 2 if isinstance(error, KickbenchError) else 1


def _call(argv: list[str]) -> int:
    import typer

    command = _command()
    if "_KICKBENCH_COMPLETE" in os.environ:
        command(prog_name="kickbench")  # a shell asks for completions
    try:
        with command.make_context("kickbench", argv) as context:
            return command.invoke(context)
    except typer.Exit as end:
        raise SystemExit(end.exit_code) from None
    except typer.TyperException as error:
        context, parameter = getattr(error, "ctx", None), getattr(error, "param", None)
        where = context.command_path if context else "kickbench"
        text = error.format_message()
        if parameter is not None and type(error) is typer.BadParameter:
            text = f"{parameter.opts[0]}: {error.message}"
        report_fault(f"{where}: {text} ({where} --help)")
        raise SystemExit(error.exit_code) from None  # type: ignore[attr-defined]


@cache
def _command() -> Any:
    from typer.main import get_command

    from kickbench.cli.app import app

    for name in _VERBS:
        import_module(f"kickbench.cli.{name}")
    return get_command(app)


def _spread(argv: list[str]) -> list[str]:
    """`--seeds 0 1` as `--seeds 0 --seeds 1`."""
    flag, spread = _LISTS.get(argv[0]) if argv else None, []
    for index, token in enumerate(argv):
        is_further = token.isdecimal() and argv[index - 1].isdecimal() and flag in spread
        spread += [flag, token] if is_further else [token]
    return spread
