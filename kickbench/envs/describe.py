"""Terms in words, for `kickbench terms`."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from pydantic.fields import FieldInfo

from kickbench.config.terms import (
    ObservationParams,
    RandomizationParams,
    RewardParams,
    TerminationParams,
    TermParams,
)
from kickbench.envs.term import Kind, Term

_INDENT = "    "
_COMMON: Mapping[Kind, type[TermParams]] = {
    "observation": ObservationParams,
    "reward": RewardParams,
    "termination": TerminationParams,
    "randomization": RandomizationParams,
}


def describe(term: Term[Any]) -> str:
    """One term: name, size, unit, source, formula and its own parameters."""
    facts = [f"unit {term.units}", f"source {term.source}"]
    if term.kind == "observation":
        facts.insert(0, f"size {term.size}")
    if term.needs:
        facts.append(f"needs {', '.join(sorted(term.needs))}")
    lines = [term.name, *_wrapped("; ".join(facts)), *_wrapped(_text(term))]
    own = {k: v for k, v in term.params.model_fields.items() if k not in _COMMON[term.kind].model_fields}
    lines += [line for name, info in own.items() for line in _parameter(name, info)]
    return "\n".join(lines) + "\n"


def describe_common(kind: Kind) -> str:
    """The parameters that every term of a kind accepts, or nothing."""
    fields = _COMMON[kind].model_fields
    return "\n".join(line for name, info in fields.items() for line in _parameter(name, info))


def _text(term: Term[Any]) -> str:
    return " ".join(term.description.split())


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 110, initial_indent=_INDENT, subsequent_indent=_INDENT)


def _parameter(name: str, info: FieldInfo) -> list[str]:
    default = "required" if info.is_required() else f"default {info.default}"
    text = f"{name}: {' '.join((info.description or '').split())} ({default})"
    return textwrap.wrap(text, 110, initial_indent=f"{_INDENT}- ", subsequent_indent=f"{_INDENT}  ")
