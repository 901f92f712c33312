"""Checkpoints and policies as files: tensors and plain values, never unpickled code.

Imports torch only where a file is written or loaded: `kickbench status` does not need it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

from kickbench.errors import KickbenchError, shown
from kickbench.results.atomic import atomic_file

if TYPE_CHECKING:
    from rsl_rl.models import MLPModel

FORMAT = 4
"""Version of a checkpoint's layout."""
_POLICY_FORMAT = 2
"""Version of a policy's layout."""


class Checkpoints:
    """The last two checkpoints of a run, files named by the iterations done.

    A checkpoint appears whole or not at all, and the one before stays beside it: if the newer cannot be read,
    a run goes on from the older.
    """

    _KEPT = 2

    def __init__(self, folder: Path) -> None:
        """Sets the folder, which the first checkpoint creates."""
        self.folder = Path(folder)

    def save(self, iteration: int, state: dict[str, Any]) -> None:
        """Writes a checkpoint, then removes all but the last two.

        Those of later iterations are removed, too: they were damaged, so the run resumed from an older one.
        """
        _write(self.folder / f"iteration_{iteration:06d}.pt", {"format": FORMAT, **state})
        older = [file for file in self.files() if iteration_of(file) <= iteration]
        for file in set(self.files()) - set(older[-self._KEPT :]):
            file.unlink(missing_ok=True)

    def files(self) -> list[Path]:
        """The checkpoints, in the order of their iterations."""
        return sorted(self.folder.glob("iteration_*.pt"), key=iteration_of)

    def load(self) -> dict[str, Any] | None:
        """Reads the newest intact checkpoint, None if there are no checkpoints; a damaged one is reported.

        Raises:
            KickbenchError: There are some and all are damaged, or the newest is of another version.
        """
        files = self.files()
        for file in reversed(files):
            try:
                state = _read(file)
            # Damage can raise any exception while the file is read.
            except Exception as error:
                print(f"{shown(file)}: damaged, it is left out: {error}", file=sys.stderr)
                continue
            if state["format"] != FORMAT:
                found = f"format {state['format']}"
                raise KickbenchError(f"{shown(file)}: {found}; this version of kickbench reads {FORMAT}")
            return state
        if files:
            raise KickbenchError(f"{shown(self.folder)}: every checkpoint is damaged")
        return None


def save_policy(path: Path, actor: Mapping[str, Any], critic: Mapping[str, Any] | None = None) -> None:
    """Writes a policy: normaliser, network, standard deviation; and the critic, for a run that begins so.

    Args:
        path: The file.
        actor: State of the policy.
        critic: State of the critic.
    """
    content = {"format": _POLICY_FORMAT, "actor_state_dict": actor}
    _write(path, content if critic is None else {**content, "critic_state_dict": critic})


def read_policy(path: Path) -> dict[str, Any]:
    """Reads what `save_policy` wrote: `actor_state_dict` and, if it was kept, `critic_state_dict`.

    Raises:
        KickbenchError: The file is missing or damaged.
    """
    if not path.exists():
        raise KickbenchError(f"{path}: no policy: the run is not finished, or was kept without it")
    try:
        return _read(path)
    except Exception as error:  # damage can raise any exception while the file is read
        raise KickbenchError(f"{shown(path)}: this policy cannot be read: {error}") from None


def load_policy(path: Path, state: Mapping[str, Any], policy: MLPModel) -> None:
    """Loads the policy of a file, or of a checkpoint's learner, into a network of the same method.

    Args:
        path: Where the state comes from, for the message.
        state: What has the `actor_state_dict`.
        policy: The network.

    Raises:
        KickbenchError: The state is that of another network.
    """
    try:
        policy.load_state_dict(state["actor_state_dict"])
    except (RuntimeError, LookupError, TypeError) as error:
        raise KickbenchError(f"{shown(path)}: this policy cannot be loaded: {error}") from None


def iteration_of(file: Path) -> int:
    """The iteration of a checkpoint, by the file's name."""
    digits = file.stem.removeprefix("iteration_")
    return int(digits) if digits.isdecimal() else -1


def is_whole(file: Path) -> bool:
    """Whether a checkpoint is as it was written, by the CRC-32 of each member of its zip archive."""
    try:
        with ZipFile(file) as archive:
            return archive.testzip() is None
    except Exception:  # damage can raise any
        return False


def _write(path: Path, content: dict[str, Any]) -> None:
    import torch

    with atomic_file(path) as file:
        torch.save(content, file)


def _read(path: Path) -> dict[str, Any]:
    """Reads a file whose CRC-32s, which torch does not check, are right."""
    import torch

    if not is_whole(path):
        raise ValueError("a CRC-32 of its content is wrong")
    return torch.load(path, weights_only=True, map_location="cpu")
