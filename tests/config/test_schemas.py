"""The committed JSON Schemas, which editors use."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kickbench.config.json_schema import json_schema
from kickbench.trials.validate import KINDS, model_of

ROOT = Path(__file__).parent.parent.parent
SHIPPED = sorted(
    p
    for folder in ("tasks", "methods", "assets", "results/reported")
    for p in (ROOT / folder).rglob("*.yaml")
)


@pytest.mark.parametrize("kind", KINDS)
def test_the_committed_schema_is_that_of_the_model(kind):
    path = ROOT / "kickbench/config/schemas" / f"{kind}.schema.json"
    assert json.loads(path.read_text()) == json.loads(json.dumps(json_schema(model_of(kind)))), (
        "run `make schemas`"
    )


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: str(p.relative_to(ROOT)))
def test_the_first_line_of_a_shipped_file_points_an_editor_at_its_schema(path):
    first = path.read_text().splitlines()[0]
    prefix = "# yaml-language-server: $schema="
    assert first.startswith(prefix)
    target = (path.parent / first.removeprefix(prefix)).resolve()
    assert target.is_file()
    assert target.parent == ROOT / "kickbench/config/schemas"
