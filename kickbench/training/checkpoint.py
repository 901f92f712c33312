"""Checkpoints and policies as files: tensors and plain values, never unpickled code.

Imports torch only where a file is written or loaded: `kickbench status` does not need it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from pickle import UnpicklingError
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


def save_policy(path: Path, policy: MLPModel, critic: MLPModel | None = None) -> None:
    """Writes a policy: normaliser, network, standard deviation; and the critic, for a run that begins so."""
    content = {"format": _POLICY_FORMAT, "actor_state_dict": policy.state_dict()}
    _write(path, content if critic is None else {**content, "critic_state_dict": critic.state_dict()})


def drop_critic(path: Path) -> None:
    """Rewrites a policy's file without the critic."""
    _write(path, {name: part for name, part in _read(path).items() if name != "critic_state_dict"})


def load_policy(path: Path, policy: MLPModel) -> None:
    """Loads a policy's weights into a network of the same method.

    Raises:
        KickbenchError: The file is missing, damaged or of another network.
    """
    if not path.exists():
        raise KickbenchError(f"{path}: no policy: the run is not finished, or was kept without it")
    _load(path, policy, lambda: _read(path)["actor_state_dict"])


def load_critic(path: Path, critic: MLPModel) -> bool:
    """Loads the critic that a policy was stored with; False: it was stored without one.

    Raises:
        KickbenchError: It is of another network.
    """
    weights = _read(path).get("critic_state_dict")
    if weights is not None:
        _load(path, critic, lambda: weights)
    return weights is not None


def load_unfinished(checkpoints: Checkpoints, policy: MLPModel) -> int:
    """Loads the policy of a run's last checkpoint into a network of the same method; returns its iteration.

    Raises:
        KickbenchError: There is no checkpoint that can be read, or it is of another network.
    """
    folder, state = checkpoints.folder, checkpoints.load()
    if state is None:
        raise KickbenchError(f"{shown(folder.parent)}: no policy and no checkpoint; train it first")
    _load(folder, policy, lambda: state["learner"]["actor_state_dict"])
    return state["iteration"]


def _load(where: Path, policy: MLPModel, weights: Callable[[], dict[str, Any]]) -> None:
    try:
        policy.load_state_dict(weights())
    except (RuntimeError, LookupError, TypeError, ValueError, EOFError, OSError, UnpicklingError) as error:
        raise KickbenchError(f"{shown(where)}: this policy cannot be loaded: {error}") from None
    policy.eval()


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
