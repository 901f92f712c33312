"""MuJoCo without its log file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

# pyright: reportAttributeAccessIssue=false
import mujoco


@contextmanager
def silent() -> Iterator[None]:
    """Keeps MuJoCo from writing MUJOCO_LOG.TXT about unstable states, for which callers look themselves."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
