"""Explains a kind of file: a resolved spec with the source of each value, and the JSON Schema for editors."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from kickbench.config.base import Spec
from kickbench.config.yamlio import EXTENDS, Document
from kickbench.config.yamltree import Node, flow_yaml
from kickbench.errors import KeyPath, dotted, from_here

_MAX_ALIGNED = 48
"""Longer lines do not push the column of sources to the right."""


def explain(spec: Spec, document: Document) -> str:
    """Writes a line a value: its key, as `--set` takes it, and the file and line, the override, or `default`.

    Keys come in the order written, then in that of the model. What is null and was not written is left out.

    Args:
        spec: A validated spec.
        document: The document it was made of.
    """
    rows = list(_rows(spec.model_dump(mode="json"), document.top, ()))
    width = max((len(text) for text, _ in rows if len(text) <= _MAX_ALIGNED), default=0)
    return "".join(f"{text:<{width}}  # {source}\n" for text, source in rows)


def _rows(value: Any, node: Node | None, path: KeyPath) -> Iterator[tuple[str, str]]:
    """Key and value, and source, of all values within one that was written at a node; None: nowhere."""
    is_deep = isinstance(value, list) and any(isinstance(item, dict) for item in value)
    if value and (is_deep or isinstance(value, dict)):
        parts = dict(enumerate(value)) if is_deep else value
        written = node.value if node and isinstance(node.value, dict | list) else {}
        below = dict(enumerate(written)) if isinstance(written, list) else written
        for key in dict.fromkeys([*(key for key in below if key in parts), *parts]):
            if parts[key] is not None or key in below:
                yield from _rows(parts[key], below.get(key), (*path, key))
    else:
        yield f"{dotted(path)}: {flow_yaml(_shown(value))}", _source(node)


def _shown(value: Any) -> Any:
    # Paths were made absolute; people want them without the machine's directories.
    return from_here(value) if isinstance(value, str) and os.path.isabs(value) else value


def _source(node: Node | None) -> str:
    """Names the places that gave a value: one, unless an override changed a part of a list."""
    if node is None:
        return "default"
    parts = node.value if isinstance(node.value, list) else []
    marks = [node.key, *(part.key for part in parts if part.origin is None)]
    return ", ".join(dict.fromkeys(mark.place for mark in marks))


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """Makes the JSON Schema (draft 2020-12) of the YAML files of a model.

    No key is required, at any depth: a file may leave out what the one that it extends has.
    """
    schema = _optional(model.model_json_schema())
    extends = {"type": "string", "description": "Path of the file to build on, relative to this file."}
    properties = {EXTENDS: extends} | schema.get("properties", {})
    return {"$schema": GenerateJsonSchema.schema_dialect} | schema | {"properties": properties}


def _optional(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_optional(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    # `required` is a keyword where it is a list; a property of that name is a schema.
    kept = {key: item for key, item in schema.items() if key != "required" or not isinstance(item, list)}
    return {key: _optional(item) for key, item in kept.items()}
