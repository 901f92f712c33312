from enum import Enum
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import Field, PrivateAttr

from kickbench.config.base import FileRef, FloatList, NameList, Range, Spec
from kickbench.config.explain import explain
from kickbench.config.problems import validate
from kickbench.config.terms import TermTable
from kickbench.config.yamlio import load_document
from kickbench.config.yamltree import dump_yaml


class Foot(Enum):
    LEFT = "left"
    RIGHT = "right"


class Term(Spec):
    weight: float
    sigma: float = 0.1
    note: str | None = None


class Task(Spec):
    name: str = "on"
    robot: FileRef | None = None
    ball: Range = (1.0, 1.0)
    gains: FloatList = (1.0, 2.0)
    names: NameList = ()
    flag: bool = True
    foot: Foot = Field(default=Foot.LEFT, strict=False)
    mode: Literal["a", "b"] = "a"
    fall: Term | None = None
    first: Term = Term(weight=1.0)
    terms: dict[str, Term] = Field(default_factory=dict)
    list: tuple[Term, ...] = Field(default=(), strict=False)
    _secret: int = PrivateAttr(default=3)


@pytest.fixture(autouse=True)
def _inside_tmp_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def explained(text: str, *overrides: str) -> str:
    Path("a.yaml").write_text(text)
    document = load_document("a.yaml", overrides)
    return explain(validate(Task, document), document)


def lines(text: str, *overrides: str) -> dict[str, str]:
    """Explains a text; returns the comment of each line that has one."""
    rows = (line.partition("  # ") for line in explained(text, *overrides).splitlines())
    return {row.rstrip(): comment for row, _, comment in rows if comment}


def test_every_value_says_where_it_came_from():
    Path("base.yaml").write_text("ball: [1, 2]\nfall:\n  weight: 1\n  sigma: 2\nmode: b\n")
    text = explained("# comment\nextends: base.yaml\nfall: {weight: 2}\nflag: false\n", "fall.sigma=1e-5")
    assert text == (
        "ball: [1.0, 2.0]   # base.yaml:1\n"
        "fall:\n"
        "  weight: 2.0      # a.yaml:3\n"
        "  sigma: 1.0e-05   # --set fall.sigma=1e-5\n"
        "  note: null       # default\n"
        "mode: b            # base.yaml:5\n"
        "flag: false        # a.yaml:4\n"
        "name: 'on'         # default\n"
        "robot: null        # default\n"
        "gains: [1.0, 2.0]  # default\n"
        "names: []          # default\n"
        "foot: left         # default\n"
        "first:\n"
        "  weight: 1.0      # default\n"
        "  sigma: 0.1       # default\n"
        "  note: null       # default\n"
        "terms: {}          # default\n"
        "list: []           # default\n"
    )


def test_keys_come_in_the_order_written_and_then_in_the_order_of_the_model():
    rows = [row.split(":")[0] for row in explained("mode: b\nname: x\n").splitlines() if row[0] != " "]
    assert rows[:4] == ["mode", "name", "robot", "ball"]


class Terms(TermTable):
    fall: Term | None = None
    slip: Term | None = None


def test_a_null_is_a_value_but_a_term_that_is_off_is_left_out_unless_a_file_says_so():
    shown = lines("name: x\nfall: null\n")
    assert (shown["fall: null"], shown["robot: null"]) == ("a.yaml:2", "default")
    Path("terms.yaml").write_text("fall: null\n")
    document = load_document("terms.yaml")
    assert explain(validate(Terms, document), document) == "fall: null  # terms.yaml:1\n"


def test_an_override_of_a_list_entry_is_named_beside_the_file():
    rows = lines("name: x\ngains:\n  - 1\n  - 2\n  - 3\n", "gains.1=5")
    assert rows["gains: [1.0, 5.0, 3.0]"] == "a.yaml:2, --set gains.1=5"


def test_an_override_of_a_whole_list_stands_alone():
    assert lines("gains: [1]\n", "gains=[2, 3]")["gains: [2.0, 3.0]"] == "--set gains=[2, 3]"


def test_a_line_break_in_an_override_does_not_end_its_comment():
    assert lines("gains: [1]\n", "gains=[2,\n 3]")["gains: [2.0, 3.0]"] == r"--set gains=[2,\n 3]"


def test_a_constant_range_is_one_number():
    assert lines("ball: 3\n")["ball: 3.0"] == "a.yaml:1"
    assert lines("name: x\n")["ball: 1.0"] == "default"


def test_a_long_list_takes_a_line_an_item():
    names = [f"a_rather_long_name_{i}" for i in range(5)]
    rows = lines(dump_yaml({"names": names}))
    assert rows["  - a_rather_long_name_3"] == "a.yaml:5"


def test_lists_of_specs_and_empty_mappings_are_written_as_yaml():
    text = explained("list:\n  - weight: 1\n  - {weight: 2, note: x}\nterms:\n  t: {weight: 3}\n")
    assert text.startswith(
        "list:\n"
        "  - weight: 1.0    # a.yaml:2\n"
        "    sigma: 0.1     # default\n"
        "    note: null     # default\n"
        "  - weight: 2.0    # a.yaml:3\n"
        "    note: x        # a.yaml:3\n"
        "    sigma: 0.1     # default\n"
        "terms:\n"
        "  t:\n"
        "    weight: 3.0    # a.yaml:5\n"
    )


def test_a_file_is_shown_relative_to_the_working_directory():
    Path("robots").mkdir()
    Path("robots/k1.xml").write_text("")
    assert lines("robot: robots/../robots/k1.xml\n")["robot: robots/k1.xml"] == "a.yaml:1"


def test_private_attributes_stay_private():
    assert "secret" not in explained("name: x\n")


def test_a_long_value_does_not_move_all_comments():
    rows = explained(f"name: {'x' * 80}\n").splitlines()
    assert rows[0].endswith("x  # a.yaml:1")
    assert rows[2] == "ball: 1.0          # default"


_MODERATE = st.floats(1e-12, 1e12) | st.floats(-1e12, -1e-12) | st.just(0.0)
_TERMS = st.fixed_dictionaries(
    {"weight": _MODERATE},
    optional={"sigma": st.floats(1e-12, 1), "note": st.none() | st.text("a: #'\n\"é")},
)
_TASKS = st.fixed_dictionaries(
    {"name": st.text()},
    optional={
        "ball": st.floats(1e-12, 10) | st.tuples(st.floats(-10, -1), st.floats(1, 10)).map(list),
        "gains": st.lists(_MODERATE),
        "names": st.lists(st.text(), max_size=12),
        "flag": st.booleans(),
        "foot": st.sampled_from(["left", "right"]),
        "fall": st.none() | _TERMS,
        "terms": st.dictionaries(st.text(), _TERMS, max_size=3),
        "list": st.lists(_TERMS, max_size=3),
    },
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(_TASKS)
def test_the_text_loads_back_to_the_same_spec(data):
    text = explained(dump_yaml(data))
    spec = validate(Task, load_document("a.yaml"))
    Path("b.yaml").write_text(text, encoding="utf-8")
    assert validate(Task, load_document("b.yaml")) == spec


def test_a_string_that_looks_like_a_path_keeps_its_control_characters():
    text = explained('names: ["/\\x1f0\\x7f"]\n')
    Path("b.yaml").write_text(text, encoding="utf-8")
    assert validate(Task, load_document("b.yaml")).names == ("/\x1f0\x7f",)
