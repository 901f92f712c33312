import json
from pathlib import Path

import jsonschema
import pytest
from pydantic import Field

from kickbench.config.base import FileRef, PositiveFloat, Range, Spec
from kickbench.config.explain import json_schema
from kickbench.config.yamlio import load_document
from kickbench.trials.validate import model_of


class Part(Spec):
    """A part."""

    mass: PositiveFloat
    """Mass, kg."""
    mesh: FileRef | None = None
    """Mesh file."""


class Body(Spec):
    """A body of the test."""

    part: Part = Part(mass=1.0)
    """Its part."""
    parts: dict[str, Part] = Field(default_factory=dict)
    """More parts."""
    range: Range = (0.0, 1.0)
    """A range."""


class Required(Spec):
    """A spec with keys that must be given."""

    robot: str
    """The robot's file."""
    body: Body = Body()
    """A body."""
    inner: Part
    """A part."""


def test_the_schema_describes_every_key():
    schema = json_schema(Body)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert (schema["title"], schema["description"]) == ("Body", "A body of the test.")
    assert schema["additionalProperties"] is False
    assert set(schema["properties"]) == {"extends", *Body.model_fields}
    assert schema["properties"]["extends"]["type"] == "string"
    assert all("description" in entry for entry in schema["properties"].values())


def test_the_schema_of_a_range_is_a_number_or_two():
    entry = json_schema(Body)["properties"]["range"]
    for value in (0.5, 2, [0.0, 1.0]):
        jsonschema.validate(value, entry)
    for value in ([0.0], [0.0, 1.0, 2.0], "1", ["0", "1"]):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(value, entry)


def test_the_schema_requires_no_key_since_a_file_may_extend_another():
    schema = json_schema(Required)
    jsonschema.validate({"extends": "a.yaml", "inner": {}}, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"inner": {"mas": 1}}, schema)


def test_every_reference_of_the_schema_leads_somewhere():
    schema = json_schema(Required)
    text = json.dumps(schema)
    names = {part.split('"')[0] for part in text.split('"#/$defs/')[1:]}
    assert names <= set(schema["$defs"])


ROOT = Path(__file__).parents[2]
SHIPPED = [
    path
    for folder in ("tasks", "methods", "assets", "results/reported")
    for path in sorted((ROOT / folder).rglob("*.yaml"))
]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_shipped_file_points_an_editor_at_its_schema_and_is_valid_by_it(path):
    """`make schemas` writes them there."""
    prefix = "# yaml-language-server: $schema="
    first = path.read_text().splitlines()[0]
    assert first.startswith(prefix)
    schema = (path.parent / first.removeprefix(prefix)).resolve()
    kind = schema.name.removesuffix(".schema.json")
    assert schema.parent == ROOT / "kickbench/config/schemas"
    schema = json.loads(json.dumps(json_schema(model_of(kind))))
    jsonschema.validate(load_document(path).data, schema, jsonschema.Draft202012Validator)
