"""`python -m kickbench.reproduce.child ...`: the command line in a process that does not outlive who started it.

If the starter is killed by SIGKILL, the kernel sends this process a SIGTERM: a training then ends after its present
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


def die_with_parent(parent: int) -> None:
    """Asks the kernel for a SIGTERM when the parent dies, and ends at once if it is dead already."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)
    if os.getppid() != parent:
        sys.exit(f"process {parent}, which has started this one, is gone")


if __name__ == "__main__":
    die_with_parent(int(os.environ.pop(PARENT)))
    from kickbench.cli import main

    sys.exit(main())
