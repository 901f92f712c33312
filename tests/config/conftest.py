"""Reading YAML texts as specs, and what is wrong with them."""

from functools import partial
from pathlib import Path

import pytest

from kickbench.config.load import load

from ..support import complaints_of


@pytest.fixture
def read(tmp_path, monkeypatch):
    """`read(model, text, *overrides)` loads a text as the file `a.yaml` of an otherwise bare directory."""
    monkeypatch.chdir(tmp_path)
    Path("robot.xml").touch()
    Path("table.yaml").touch()

    def read(model, text: str, *overrides: str):
        Path("a.yaml").write_text(text)
        return load(model, "a.yaml", overrides).spec

    return read


@pytest.fixture
def complaints(read):
    """`complaints(model, text, *overrides)` lists the problems of a text that has some, as people read them."""

    return partial(complaints_of, read)
