"""Scalars follow the core schema of YAML 1.2; what a file must not contain is tested in `test_yamlio`."""

from pathlib import Path

import pytest

from kickbench.config.yamltree import Located, describe, parse


def value(text: str):
    data = parse(f"x: {text}\n", Path("a.yaml")).data()["x"]
    return str(data) if isinstance(data, Located) else data


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("1e-3", 1e-3),
        ("1E5", 1e5),
        (".5", 0.5),
        ("-1.5e+3", -1500.0),
        ("2.", 2.0),
        ("+1.0", 1.0),
        ("-0", 0),
        ("12", 12),
        ("010", 10),
    ],
)
def test_numbers_are_numbers(text, number):
    assert value(text) == number
    assert type(value(text)) is type(number)


@pytest.mark.parametrize(
    "text",
    [
        "on",
        "off",
        "yes",
        "no",
        "On",
        "NO",
        "y",
        "1:30",
        "2026-01-01",
        "1_000",
        "1e",
        "=",
        "0b1",
        "0x1F",
        ".inf",
    ],
)
def test_what_yaml_1_1_would_convert_is_a_string(text):
    assert value(text) == text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("true", True),
        ("True", True),
        ("FALSE", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("'1'", "1"),
        ('"true"', "true"),
        ("!!str 1", "1"),
        ("!!float 1", 1.0),
    ],
)
def test_booleans_nulls_quotes_and_core_tags(text, expected):
    assert value(text) == expected
    assert type(value(text)) is type(expected)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "null"),
        (True, "true"),
        (2, "the number 2"),
        (1e-5, "the number 1e-05"),
        ("abc", "the string 'abc'"),
        ("x" * 100, f"the string '{'x' * 57}...'"),
        ([], "an empty list"),
        ((1, 2), "a list of 2"),
        ({"a": 1}, "a mapping"),
        ({}, "an empty mapping"),
        (b"", "a bytes"),
    ],
)
def test_a_value_found_is_described_in_words(value, words):
    assert describe(value) == words
