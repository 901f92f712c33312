"""OpenGL without a screen: finds a platform that works here."""

from __future__ import annotations

import os
from ctypes.util import find_library
from importlib import import_module
from typing import Any

from kickbench.errors import KickbenchError

_PLATFORMS = ("glfw", "osmesa", "egl")
_HELP = "a machine without a screen needs OSMesa (apt-get install libosmesa6) or EGL; MUJOCO_GL={} picks one"


def check_mujoco() -> None:
    """Checks that MuJoCo can be imported: on import it loads the libraries that MUJOCO_GL names.

    Raises:
        KickbenchError: MUJOCO_GL names a platform that is not there.
    """
    try:
        import_module("mujoco")
    except (ImportError, AttributeError, RuntimeError) as error:
        raise _no_opengl(f"MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}", error) from None


def make_context(width: int, height: int) -> Any:
    """Makes an OpenGL context, current in this thread.

    If MUJOCO_GL is set, it decides. It is read here because MuJoCo reads it only once, on import.

    Args:
        width: Width of the largest picture, pixels.
        height: Its height, pixels.

    Raises:
        KickbenchError: The platform does not work.
    """
    platform = _platform()
    try:
        context = import_module(f"mujoco.{platform}").GLContext(width, height)
        context.make_current()
    except Exception as error:  # every platform has its own exceptions
        raise _no_opengl(platform, error) from None
    return context


def _platform() -> str:
    named = os.environ.get("MUJOCO_GL", "").strip().lower()
    if named in _PLATFORMS:
        return named
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return "glfw"
    return "osmesa" if find_library("OSMesa") else "egl"


def _no_opengl(tried: str, error: Exception) -> KickbenchError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return KickbenchError(f"no OpenGL to draw with ({tried}: {reason}): {_HELP.format('|'.join(_PLATFORMS))}")
