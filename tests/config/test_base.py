import json
from enum import Enum
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, ValidationError, model_validator

from kickbench.config.base import (
    FileRef,
    FloatList,
    Fraction,
    NameList,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    Range,
    Spec,
    Vector3,
)
from kickbench.config.problems import validate
from kickbench.config.yamlio import load_document
from kickbench.errors import SpecError


class Side(Enum):
    LEFT = "left"
    RIGHT = "right"


class Part(Spec):
    """A part."""

    mass: PositiveFloat
    """Mass,
    kg."""
    mesh: FileRef | None = None
    """Mesh file."""


class Servo(Spec):
    kind: Literal["servo"] = "servo"
    kp: float


class Motor(Spec):
    kind: Literal["motor"] = "motor"
    effort: float


class Body(Spec):
    """A body of the test."""

    name: str = "body"
    """Its name."""
    part: Part = Part(mass=1.0)
    """Its part."""
    parts: dict[str, Part] = Field(default_factory=dict)
    """More parts."""
    list: tuple[Part, ...] = Field(default=(), strict=False, max_length=2)
    """A list of parts."""
    sides: dict[Literal["left", "right"], int] = Field(default_factory=dict)
    """A number a side."""
    scale: Fraction = 0.5
    """A fraction."""
    count: NonNegativeInt = 0
    """A count."""
    schedule: Literal["adaptive", "fixed"] = "fixed"
    """A choice."""
    side: Side = Field(default=Side.LEFT, strict=False)
    """An enum."""
    range: Range = (0.0, 1.0)
    """A range."""
    limit: Range | None = None
    """Perhaps a range."""
    vector: Vector3 = (0.0, 0.0, 0.0)
    """A vector."""
    gains: FloatList = Field(default=(1.0, 1.0), min_length=2, max_length=3)
    """Gains."""
    names: NameList = ()
    """Names."""
    size: PositiveInt | Literal["joints", "actions"] = 1
    """A union."""
    on: bool = False
    """A switch."""
    drive: Annotated[Servo | Motor, Field(discriminator="kind")] = Servo(kp=1.0)
    """A discriminated union."""
    files: tuple[FileRef, ...] = Field(default=(), strict=False)
    """Files."""
    even: int = 0
    """A number with a rule of its own."""

    @model_validator(mode="after")
    def _rule(self) -> "Body":
        if self.even % 2:
            raise ValueError(f"{self.even} is odd")
        return self


class Required(Spec):
    robot: str
    """The robot's file."""
    body: Body = Body()
    """A body."""
    inner: Part
    """A part."""


@pytest.fixture(autouse=True)
def _inside_tmp_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def read(text: str, *overrides: str, model=Body, name: str = "a.yaml"):
    Path(name).parent.mkdir(parents=True, exist_ok=True)
    Path(name).write_text(text)
    return validate(model, load_document(name, overrides))


def problems(text: str, *overrides: str, **kwargs) -> list[tuple]:
    """Validates a text that has problems; returns (mark, path, message, hint) of each."""
    with pytest.raises(SpecError) as error:
        read(text, *overrides, **kwargs)
    return [(str(p.mark), p.path, p.message, p.hint) for p in error.value.problems]


# Values


def test_lists_become_tuples():
    body = read("vector: [1, 2, 3]\nnames: [a, b]\ngains: [1, 2]\nlist: [{mass: 1}]\n")
    assert body.vector == (1.0, 2.0, 3.0)
    assert body.names == ("a", "b")
    assert body.gains == (1.0, 2.0)
    assert body.list == (Part(mass=1.0),)


def test_a_spec_is_frozen():
    with pytest.raises(ValidationError, match="frozen"):
        read("name: a\n").name = "b"


def test_a_whole_number_is_a_number():
    assert isinstance(read("scale: 1\n").scale, float)


def test_a_range_is_two_numbers_or_a_constant():
    assert read("range: [-1, 2]\n").range == (-1.0, 2.0)
    assert read("range: 3\n").range == (3.0, 3.0)
    assert isinstance(read("range: 3\n").range[0], float)


@pytest.mark.parametrize(
    ("text", "wrong"), [("[3, 1]", "reversed"), ("[1, 1]", "empty"), ("[1.0, 1]", "empty")]
)
def test_a_reversed_or_empty_range_says_so(text, wrong):
    message = f"the range {text} is {wrong}: low must be less than high; a constant is one number"
    assert problems(f"name: a\nrange: {text}\n") == [("a.yaml:2:8", ("range",), message, None)]


@pytest.mark.parametrize(
    ("text", "found"),
    [("abc", "the string 'abc'"), ("true", "true"), ("[1]", "a list of 1"), ("{}", "an empty mapping")],
)
def test_a_range_of_another_form_says_its_form(text, found):
    message = f"expected a number or [low, high], found {found}"
    assert problems(f"limit: {text}\n") == [("a.yaml:1:8", ("limit",), message, None)]


def test_a_bound_that_is_no_number_has_its_own_place():
    message = "expected a valid number, found the string 'x'"
    assert problems("range: [1, x]\n") == [("a.yaml:1:12", ("range", 1), message, None)]


def test_a_dumped_spec_reads_back():
    body = read("range: 3\nlimit: [1, 2]\ndrive: {kind: motor, effort: 2}\nside: right\n")
    assert Body.model_validate(body.model_dump()) == body
    assert Body.model_validate(json.loads(json.dumps(body.model_dump(mode="json")))) == body


# Problems


def test_an_unknown_key_lists_the_known_ones():
    message = "unknown key 'mas'; expected one of: mass, mesh"
    hint = "did you mean 'mass'?"
    assert problems("part:\n  mass: 1\n  mas: 2\n") == [("a.yaml:3:3", ("part", "mas"), message, hint)]


@pytest.mark.parametrize(
    ("text", "mark", "path"),
    [
        ("parts: {a: {Mass: 1}}\n", "a.yaml:1:13", ("parts", "a", "Mass")),
        ("list:\n- {mass: 1}\n- {Mass: 1}\n", "a.yaml:3:4", ("list", 1, "Mass")),
    ],
)
def test_an_unknown_key_hints_at_the_nearest(text, mark, path):
    message = "unknown key 'Mass'; expected one of: mass, mesh"
    assert (mark, path, message, "did you mean 'mass'?") in problems(text)


def test_extends_further_down_is_explained():
    [(mark, path, _, hint)] = problems("part: {mass: 1, extends: b.yaml}\n")
    assert (mark, path, hint) == (
        "a.yaml:1:17",
        ("part", "extends"),
        "`extends` stands at the top of a file only",
    )


def test_a_missing_key_has_the_mark_of_its_parent_and_says_what_it_is():
    assert problems("inner:\n  mesh: null\n", model=Required) == [
        ("a.yaml:1:1", ("robot",), "missing key 'robot'", "The robot's file."),
        ("a.yaml:1:1", ("inner", "mass"), "missing key 'mass'", "Mass, kg."),
    ]
    assert problems("robot: a\nbody: {part: {}}\ninner: {mass: 1}\n", model=Required) == [
        ("a.yaml:2:8", ("body", "part", "mass"), "missing key 'mass'", "Mass, kg.")
    ]


@pytest.mark.parametrize(
    ("text", "column", "path", "message", "hint"),
    [
        ("scale: abc", 8, ("scale",), "expected a valid number, found the string 'abc'", None),
        ("scale: '1'", 8, ("scale",), "expected a valid number, found the string '1'", None),
        ("scale: 1_0", 8, ("scale",), "expected a valid number, found the string '1_0'", None),
        ("scale: true", 8, ("scale",), "expected a valid number, found true", None),
        ("scale: null", 8, ("scale",), "expected a valid number, found null", None),
        (
            "scale: 1.5",
            8,
            ("scale",),
            "expected a number less than or equal to 1, found the number 1.5",
            None,
        ),
        ("count: 1.5", 8, ("count",), "expected a valid integer, found the number 1.5", None),
        ("count: 1.0", 8, ("count",), "expected a valid integer, found the number 1.0", None),
        (
            "count: -1",
            8,
            ("count",),
            "expected a number greater than or equal to 0, found the number -1",
            None,
        ),
        (
            "part: {mass: 0}",
            14,
            ("part", "mass"),
            "expected a number greater than 0, found the number 0",
            None,
        ),
        ("name: 3", 7, ("name",), "expected a valid string, found the number 3", None),
        ("name: [a]", 7, ("name",), "expected a valid string, found a list of 1", None),
        ("on: on", 5, ("on",), "expected a valid boolean, found the string 'on'", None),
        ("on: 1", 5, ("on",), "expected a valid boolean, found the number 1", None),
        ("names: a", 8, ("names",), "expected a list, found the string 'a'", None),
        ("names: [a, 1]", 12, ("names", 1), "expected a valid string, found the number 1", None),
        ("vector: [1, 2]", 9, ("vector",), "expected more entries, found a list of 2", None),
        ("vector: []", 9, ("vector",), "expected more entries, found an empty list", None),
        (
            "vector: [1, 2, 3, 4]",
            9,
            ("vector",),
            "expected at most 3 items, found a list of 4",
            None,
        ),
        ("gains: [1]", 8, ("gains",), "expected at least 2 items, found a list of 1", None),
        (
            "gains: [1, 2, 3, 4]",
            8,
            ("gains",),
            "expected at most 3 items, found a list of 4",
            None,
        ),
        ("part: 1", 7, ("part",), "expected a mapping, found the number 1", None),
        ("part: []", 7, ("part",), "expected a mapping, found an empty list", None),
        ("parts: 1", 8, ("parts",), "expected a mapping, found the number 1", None),
        ("even: 3", 1, (), "3 is odd", None),
        ("body: 1\n", 1, ("body",), "unknown key 'body'", None),
    ],
)
def test_a_wrong_value_says_what_was_expected_and_found(text, column, path, message, hint):
    [(mark, found_path, found_message, found_hint)] = problems(text + "\n")
    assert (mark, found_path) == (f"a.yaml:1:{column}", path)
    assert found_message.startswith(message)
    assert (hint or "") in (found_hint or "")


def test_a_wrong_choice_lists_the_choices():
    message = "expected one of: adaptive, fixed, found the string 'Adaptiv'"
    hint = "did you mean 'adaptive'?"
    assert problems("schedule: Adaptiv\n") == [("a.yaml:1:11", ("schedule",), message, hint)]


def test_a_wrong_enum_lists_the_choices():
    message = "expected one of: left, right, found the string 'lefft'"
    assert problems("side: lefft\n") == [("a.yaml:1:7", ("side",), message, "did you mean 'left'?")]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("gains: [1, x]", ["expected a valid number, found the string 'x'"]),
        (
            "gains: [x]",
            [
                "expected at least 2 items, found a list of 1",
                "expected a valid number, found the string 'x'",
            ],
        ),
        (
            "vector: [1, x]",
            ["expected more entries, found a list of 2", "expected a valid number, found the string 'x'"],
        ),
    ],
)
def test_a_wrong_entry_does_not_make_a_list_short(text, found):
    assert [problem[2] for problem in problems(f"{text}\n")] == found


def test_a_wrong_key_of_a_typed_dict_lists_the_choices():
    message = "unknown key 'lefft'; expected one of: left, right"
    hint = "did you mean 'left'?"
    assert problems("sides: {right: 1, lefft: 2}\n") == [("a.yaml:1:19", ("sides", "lefft"), message, hint)]


def test_each_alternative_of_a_union_is_a_problem():
    found, hint = "found the string 'joint'", "did you mean 'joints'?"
    assert problems("size: joint\n") == [
        ("a.yaml:1:7", ("size",), f"expected a valid integer, {found}", None),
        ("a.yaml:1:7", ("size",), f"expected one of: joints, actions, {found}", hint),
    ]


def test_a_discriminated_union_names_its_key():
    message = "expected one of: servo, motor, found the string 'moter'"
    hint = "did you mean 'motor'?"
    assert problems("drive: {kind: moter}\n") == [("a.yaml:1:15", ("drive", "kind"), message, hint)]
    assert problems("drive: {kp: 1}\n") == [("a.yaml:1:1", ("drive", "kind"), "missing key 'kind'", None)]
    assert problems("drive: {kind: servo}\n") == [("a.yaml:1:1", ("drive", "kp"), "missing key 'kp'", None)]


def test_all_problems_come_at_once_in_the_order_of_the_lines():
    text = "schedule: x\non: 1\npart: {mass: -1, mesh: no.obj}\nname: 2\nnmae: a\n"
    assert [found[0] for found in problems(text)] == [
        "a.yaml:1:11",
        "a.yaml:2:5",
        "a.yaml:3:14",
        "a.yaml:3:24",
        "a.yaml:4:7",
        "a.yaml:5:1",
    ]


def test_a_wrong_override_names_itself():
    message = "unknown key 'mas'; expected one of: mass, mesh"
    found = problems("part: {mass: 1}\n", "part.mas=3")
    assert found == [("--set part.mas=3", ("part", "mas"), message, "did you mean 'mass'?")]
    message = "expected a valid number, found the string 'x'"
    assert problems("scale: 1\n", "scale=x") == [("--set scale=x", ("scale",), message, None)]


def test_a_problem_of_an_extended_file_points_there():
    Path("base.yaml").write_text("name: 1\n")
    found = problems("extends: base.yaml\nscale: 2\n")
    assert [problem[0] for problem in found] == ["a.yaml:2:8", "base.yaml:1:7"]


# Files


def test_files_are_relative_to_the_file_that_names_them():
    for name in ("meshes/a.obj", "other/meshes/b.obj", "c.obj"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text("")
    Path("other/base.yaml").write_text("part: {mass: 1, mesh: meshes/b.obj}\n")
    text = "extends: other/base.yaml\nparts: {p: {mass: 1, mesh: meshes/a.obj}}\nfiles: [meshes/a.obj]\n"
    body = read(text, "list=[{mass: 1, mesh: c.obj}]")
    here = Path.cwd().as_posix()
    assert body.part.mesh == f"{here}/other/meshes/b.obj"
    assert body.parts["p"].mesh == f"{here}/meshes/a.obj"
    assert body.files == (f"{here}/meshes/a.obj",)
    assert body.list[0].mesh == f"{here}/c.obj"


def test_an_override_is_relative_to_the_working_directory():
    Path("a.obj").write_text("")
    body = read("name: a\n", "part={mass: 1, mesh: a.obj}", name="tasks/a.yaml")
    assert body.part.mesh == (Path.cwd() / "a.obj").as_posix()


def test_a_missing_file_hints_at_the_nearest():
    Path("robot.obj").write_text("")
    found = problems("parts:\n  p: {mass: 1, mesh: robott.obj}\n")
    message, hint = "no such file: 'robott.obj'", "did you mean 'robot.obj'?"
    assert found == [("a.yaml:2:22", ("parts", "p", "mesh"), message, hint)]


def test_a_directory_is_no_file():
    Path("folder").mkdir()
    message = "'folder' cannot be read: Is a directory"
    assert problems("files: [folder]\n") == [("a.yaml:1:9", ("files", 0), message, None)]


def test_a_file_name_that_is_no_string_is_a_wrong_type():
    message = "expected a valid string, found the number 3"
    assert problems("files: [3]\n") == [("a.yaml:1:9", ("files", 0), message, None)]


def test_the_document_keeps_what_was_written():
    Path("a.obj").write_text("")
    Path("a.yaml").write_text("files: [a.obj]\n")
    document = load_document("a.yaml")
    validate(Body, document)
    assert document.data == {"files": ["a.obj"]}
