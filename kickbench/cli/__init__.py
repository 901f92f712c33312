"""The command line: parse, call, report faults. Verbs import what they need when they are called."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from typing import Any, TextIO

from kickbench.errors import KickbenchError, printable, shown

_VERBS = ("train", "look", "policies", "define", "robot", "check")
"""Modules with verbs."""
_LISTS = {"reproduce": "--seeds", "bench": "--num-envs"}
"""Options that take several numbers at once."""
_NO_MEMORY = ("DefaultCPUAllocator", "can't allocate memory", "CUDA out of memory", "Cannot allocate memory")


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
            sys.stdout.flush()  # here, where the error of a full disk is still handled
        return code
    except KeyboardInterrupt:
        _report("interrupted")
        return 130
    except BrokenPipeError:
        # The reader of our output has gone (`kickbench show ... | head`).
        _mute(sys.stdout, sys.stderr)
        return 1
    except Exception as error:
        message = _fault(error)
        if message is None:
            raise
        _mute(sys.stdout)
        _report(message)
        return 2 if isinstance(error, KickbenchError) else 1


def _call(argv: list[str]) -> int:
    import typer

    command = _command()
    if "_KICKBENCH_COMPLETE" in os.environ:
        command(prog_name="kickbench")  # a shell asks for completions
    try:
        with command.make_context("kickbench", argv) as context:
            return command.invoke(context) or 0
    except typer.Exit as end:
        raise SystemExit(end.exit_code) from None
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        where = context.command_path if context else "kickbench"
        text = error.format_message().replace("Value error, ", "")
        _report(printable(f"{where}: {text} ({where} --help)"))
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


def _fault(error: Exception) -> str | None:
    """The fault of the user or the system, in one line; None: a defect of kickbench, shown as a traceback."""
    if isinstance(error, KickbenchError):
        return printable(str(error))
    if isinstance(error, OSError):
        where = f"{shown(os.fsdecode(error.filename))}: " if isinstance(error.filename, str | bytes) else ""
        return f"{where}{error.strerror or error}"
    if isinstance(error, RecursionError):
        return "the input is nested too deeply"
    # torch's and MuJoCo's own errors, known by their names: importing them takes seconds.
    kind, text = type(error).__name__, " ".join(str(error).split())
    if isinstance(error, MemoryError) or kind == "OutOfMemoryError" or any(t in text for t in _NO_MEMORY):
        reason = text[:200] or "the system gives no more"
        return f"not enough memory: {reason}; --num-envs takes fewer environments"
    return f"MuJoCo: {text}" if kind == "FatalError" else None


def _report(text: str) -> None:
    """Prints a line to standard error, which may be closed, full or missing."""
    with suppress(OSError, ValueError, AttributeError):
        print(text, file=sys.stderr, flush=True)


def _mute(*streams: TextIO | None) -> None:
    """Discards what is still buffered, on which the interpreter would fail again when it ends."""
    for stream in streams:
        with suppress(OSError, ValueError, AttributeError), open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())  # type: ignore[union-attr]
