"""A process that does not outlive who has started it.

If the starter is killed by SIGKILL, the kernel sends the process a SIGTERM: a training then ends after its present
iteration, with a checkpoint, and its folder is free for whoever goes on.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PARENT = "KICKBENCH_PARENT"
"""Environment variable with the starter's process id."""

_PR_SET_PDEATHSIG = 1


def die_with_parent() -> None:
    """Asks the kernel for a SIGTERM when the starter dies, and ends at once if it is dead already.

    Does nothing in a process that nobody has started in this way.
    """
    parent = os.environ.pop(PARENT, None)
    if parent is None:
        return
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)
    if os.getppid() != int(parent):
        sys.exit(f"process {parent}, which has started this one, is gone")
