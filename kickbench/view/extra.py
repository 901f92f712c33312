"""Libraries that only pictures need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from kickbench.errors import KickbenchError


def require(module: str, purpose: str) -> Any:
    """Imports a library of the extra `view`.

    Args:
        module: Full name of the module.
        purpose: What it is needed for, as the start of the message: `a .mp4`.

    Raises:
        KickbenchError: The library is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError:
        library = module.partition(".")[0]
        raise KickbenchError(
            f"{purpose} needs {library}, which is not installed: pip install 'kickbench[view]'"
        ) from None
