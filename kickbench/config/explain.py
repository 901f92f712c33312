"""Explains a kind of file: a resolved spec with the source of each value, and the JSON Schema for editors."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from kickbench.config.base import Spec
from kickbench.config.task import CurriculumSpec
from kickbench.config.terms import TermParams, TermTable
from kickbench.config.yamlio import EXTENDS, Document
from kickbench.config.yamltree import Node, flow_yaml, value_at
from kickbench.errors import from_here

_MAX_FLOW = 72
"""Longer lists are written one item a line."""
_MAX_ALIGNED = 48
"""Longer lines do not push the column of comments to the right."""


def explain(spec: Spec, document: Document) -> str:
    """Writes a spec as YAML with a comment on each value: the file and line, the override, or `default`.

    The text loads back to the same spec if it is saved in the working directory. Terms, parameters of
    terms and ramps that are off and that no file wrote are left out.

    Args:
        spec: A validated spec.
        document: The document it was made of.
    """
    data = _visible(spec.model_dump(mode="json"), document.data, spec)
    lines = list(_lines(data, document.top)) or [("{}", "")]
    width = max((len(text) for text, source in lines if source and len(text) <= _MAX_ALIGNED), default=0)
    return "".join(f"{text:<{width}}  # {source}\n" if source else f"{text}\n" for text, source in lines)


def _visible(value: Any, written: Any, spec: Any) -> Any:
    """Drops terms, parameters and ramps that are off, and puts written keys first, in the order written."""
    if isinstance(value, list):
        return [_visible(item, value_at(written, (i,)), spec[i]) for i, item in enumerate(value)]
    if not isinstance(value, dict):
        return value
    written = written if isinstance(written, dict) else {}
    order = dict.fromkeys([*(key for key in written if key in value), *value])
    if isinstance(spec, TermTable | TermParams | CurriculumSpec):
        order = [key for key in order if value[key] is not None or key in written]
    parts = dict(spec)
    return {key: _visible(value[key], written.get(key), parts.get(key)) for key in order}


def _lines(value: Any, node: Node | None) -> Iterator[tuple[str, str]]:
    """Lines of YAML, each with the source of its value; empty: only values further in have some.

    Args:
        value: A mapping or a list.
        node: Where it was written; None: nowhere.
    """
    is_list = isinstance(value, list)
    for key, item in enumerate(value) if is_list else value.items():
        below, head = _below(node, key), "-" if is_list else f"{flow_yaml(key)}:"
        if _is_leaf(item):
            yield f"{head} {flow_yaml(_shown(item))}", _source(below)
            continue
        if not is_list:
            yield head, ""
        for number, (text, source) in enumerate(_lines(item, below)):
            yield ("- " if is_list and number == 0 else "  ") + text, source


def _below(node: Node | None, key: str | int) -> Node | None:
    """Where a part was written; a scalar may stand for a whole structure."""
    if node is None or not isinstance(node.value, dict | list):
        return node
    return value_at(node.value, (key,))


def _is_leaf(value: Any) -> bool:
    if isinstance(value, list):
        flat = not any(isinstance(item, dict | list) and item for item in value)
        return flat and len(flow_yaml(value)) <= _MAX_FLOW
    return not isinstance(value, dict) or not value


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
