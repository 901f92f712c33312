"""Flags that set the same key as a `--set` may."""

from __future__ import annotations

from collections.abc import Sequence

from kickbench.errors import SpecError


def override_of(overrides: Sequence[str], key: str) -> str | None:
    """The override that gives a key its value: the last one."""
    own = [text for text in overrides if _key(text) == key]
    return own[-1] if own else None


def refuse_contradiction(overrides: Sequence[str], key: str, flag: str, values: Sequence[int] | None) -> None:
    """Refuses a flag and a `--set` that give one key two values: one of them would be ignored.

    Args:
        overrides: `key.path=value` texts.
        key: The key that the flag sets.
        flag: The flag.
        values: What the flag gives; None if it is not there.

    Raises:
        SpecError: They differ.
    """
    override = override_of(overrides, key)
    if override is None or not values:
        return
    if {override.partition("=")[2].strip()} != set(map(str, values)):
        given = " ".join(map(str, values))
        raise SpecError.of(f"--set {override}", f"{flag} {given} sets {key}, too: give one of them only")


def _key(override: str) -> str:
    return ".".join(part.strip() for part in override.partition("=")[0].split("."))
