import string
from pathlib import Path

import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from kickbench.config.yamltree import Located, dump_yaml, flow_yaml, parse

_CHARACTERS = st.characters(exclude_categories=["Cs"])
_WORDS = ["on", "no", "1e-3", "1_0", ".5", "1:30", "2026-01-01", "010", "~"]
_SIGNS = ["", " ", "=", "<<", "- a", "a: b", "#", "\ufeff"]
_TRICKY = st.sampled_from(_WORDS + _SIGNS)
_STRINGS = st.text(_CHARACTERS) | st.text(string.printable) | _TRICKY
_FLOATS = st.floats(1e-12, 1e12) | st.floats(-1e12, -1e-12) | st.just(0.0)
_SCALARS = st.none() | st.booleans() | st.integers(-(10**12), 10**12) | _FLOATS | _STRINGS
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_STRINGS, inner, max_size=4),
    max_leaves=10,
)


def _load(text: str):
    return parse(text, Path("a.yaml")).data()


def _same(one, other) -> bool:
    """Equality that tells 1 from 1.0 and True, and one order of keys from another."""
    if isinstance(one, dict) and isinstance(other, dict):
        return list(one) == list(other) and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    return one == other and type(one) in (type(other), Located)


@settings(max_examples=120, deadline=None)
@given(_VALUES)
def test_what_is_written_loads_back(data):
    assert _same(_load(dump_yaml(data)), data)
    assert _same(_load(flow_yaml(data)), data)


@settings(max_examples=100, deadline=None)
@given(_VALUES)
def test_other_readers_load_the_same(data):
    assert _same(yaml.safe_load(dump_yaml(data)), data)


@settings(max_examples=100, deadline=None)
@given(_VALUES)
def test_flow_style_stays_on_one_line(data):
    assert len(flow_yaml(data).splitlines()) == 1


def test_a_string_of_a_file_is_written_as_any_other():
    assert flow_yaml([Located("on"), Located("relu")]) == flow_yaml(["on", "relu"])


def test_written_yaml_is_plain_and_in_order():
    data = {"b": [1, 1e-05, (2.5, "on")], "a": {"x": None, "y": True}, "s": "1e-3", "e": {}}
    assert dump_yaml(data) == (
        "b:\n  - 1\n  - 1.0e-05\n  - - 2.5\n    - 'on'\na:\n  x: null\n  y: true\ns: '1e-3'\ne: {}\n"
    )
