"""YAML text that loads back to the same data, here and in other readers."""

from __future__ import annotations

import math
from typing import Any

import yaml

from kickbench.config.yamltree import core_tag

_STRING = "tag:yaml.org,2002:str"


def dump_yaml(data: Any) -> str:
    """Writes mappings, lists and scalars as block YAML, in the order of the keys.

    Raises:
        ValueError: A number is not finite.
        yaml.representer.RepresenterError: A value is not of a type that YAML files have.
    """
    return _dump(data, flow=False, width=100)


def flow_yaml(data: Any) -> str:
    """Writes a value as YAML on one line: `[0.1, 0.2]`, `abc`, `'on'`.

    Raises:
        ValueError: A number is not finite.
        yaml.representer.RepresenterError: A value is not of a type that YAML files have.
    """
    return _dump(data, flow=True, width=math.inf).removesuffix("...\n").rstrip("\n")


def _dump(data: Any, flow: bool, width: float) -> str:
    return yaml.dump(
        data, Dumper=_Dumper, sort_keys=False, default_flow_style=flow, allow_unicode=True, width=width
    )


class _Dumper(yaml.SafeDumper):
    """Leaves a string without quotes only if it is a string by the rules of YAML 1.1 and 1.2 alike."""

    def resolve(self, kind: Any, value: Any, implicit: Any) -> str:
        if kind is not yaml.ScalarNode or not implicit[0]:
            return super().resolve(kind, value, implicit)
        tag = core_tag(value)
        return tag if tag != _STRING else super().resolve(kind, value, implicit)

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        # PyYAML does not indent lists below their key; our files do.
        super().increase_indent(flow, False)


def _represent_str(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    # Double quotes escape line breaks, which every other style would fold or indent.
    return dumper.represent_scalar(_STRING, text, style=None if text.isprintable() else '"')


def _represent_float(dumper: _Dumper, value: float) -> yaml.ScalarNode:
    if not math.isfinite(value):
        raise ValueError(f"{value} has no place in a YAML file")
    return dumper.represent_float(value)


_Dumper.add_representer(str, _represent_str)
_Dumper.add_representer(float, _represent_float)
_Dumper.add_representer(tuple, _Dumper.represent_list)
