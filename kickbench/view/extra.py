"""Libraries that only pictures and reports need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from kickbench.errors import KickbenchError


def require(module: str, purpose: str, extra: str = "view") -> Any:
    """Imports a library of an extra.

    Args:
        module: Full name of the module.
        purpose: What it is needed for, as the start of the message: `a .mp4`.
        extra: The extra that installs it.

    Raises:
        KickbenchError: The library is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError:
        library = module.partition(".")[0]
        raise KickbenchError(
            f"{purpose} needs {library}, which is not installed: pip install 'kickbench[{extra}]'"
        ) from None
