"""OpenGL without a screen: finds a platform that works here."""

from __future__ import annotations

import os
from collections.abc import Iterator
from ctypes.util import find_library
from importlib import import_module
from typing import Any

from kickbench.errors import KickbenchError

_PLATFORMS = ("glfw", "osmesa", "egl")
_HELP = "a machine without a screen needs OSMesa (apt-get install libosmesa6) or EGL; MUJOCO_GL={} picks one"


def check_mujoco() -> None:
    """Checks that MuJoCo can be imported: it looks for MUJOCO_GL's libraries then, and fails in its own ways.

    Raises:
        KickbenchError: MUJOCO_GL names a platform that is not there.
    """
    try:
        import_module("mujoco")
    except (ImportError, AttributeError, RuntimeError) as error:
        raise _no_opengl([f"MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}: {_reason(error)}"]) from None


def make_context(width: int, height: int) -> Any:
    """Makes an OpenGL context, current in this thread.

    MUJOCO_GL decides, where it is set. It is read here rather than left to MuJoCo, which reads it once, on import.

    Args:
        width: Width of the largest picture, pixels.
        height: Its height, pixels.

    Raises:
        KickbenchError: No platform works.
    """
    reasons = []
    for platform in _candidates():
        try:
            context = import_module(f"mujoco.{platform}").GLContext(width, height)
            context.make_current()
            return context
        except Exception as error:  # every platform has exceptions of its own
            reasons.append(f"{platform}: {_reason(error)}")
    raise _no_opengl(reasons)


def _candidates() -> Iterator[str]:
    named = os.environ.get("MUJOCO_GL", "").strip().lower()
    if named in _PLATFORMS:
        yield named
        return
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        yield "glfw"
    # One of the two at most: PyOpenGL keeps to the platform of its first import.
    if find_library("OSMesa"):
        yield "osmesa"
    elif find_library("EGL"):
        yield "egl"


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _no_opengl(reasons: list[str]) -> KickbenchError:
    tried = f" ({'; '.join(reasons)})" if reasons else ""
    return KickbenchError(f"no OpenGL to draw with{tried}: {_HELP.format('|'.join(_PLATFORMS))}")
