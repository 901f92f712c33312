"""JSON Schema of a spec, for editors that complete and check YAML."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from kickbench.config.yamlio import EXTENDS

_REF = "#/$defs/"
_PARTIAL = "Partial"


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """Makes the JSON Schema (draft 2020-12) of the YAML files of a model.

    A file that extends another may leave out any key at any depth, so what is required is stated in a second,
    complete copy of the schema, which only a file without `extends` must meet.
    """
    complete = model.model_json_schema()
    definitions = complete.pop("$defs", {})
    partial = {f"{name}{_PARTIAL}": _optional(schema) for name, schema in definitions.items()}
    root = _optional(complete)
    extends = {"type": "string", "description": "Path of the file to build on, relative to this file."}
    root["properties"] = {EXTENDS: extends} | root.get("properties", {})
    rule = {"if": {"not": {"required": [EXTENDS]}}, "then": {"$ref": f"{_REF}{model.__name__}"}}
    head = {"$schema": GenerateJsonSchema.schema_dialect, "title": model.__name__}
    return head | root | rule | {"$defs": {model.__name__: complete} | definitions | partial}


def _optional(schema: Any) -> Any:
    """Copies a schema without what is required, its references pointing to other such copies."""
    if isinstance(schema, list):
        return [_optional(item) for item in schema]
    if isinstance(schema, str) and schema.startswith(_REF):
        return f"{schema}{_PARTIAL}"
    if not isinstance(schema, dict):
        return schema
    # `required` is a keyword where it is a list; a property of that name is a schema.
    kept = {key: item for key, item in schema.items() if key != "required" or not isinstance(item, list)}
    return {key: _optional(item) for key, item in kept.items()}
