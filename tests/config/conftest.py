"""Reading YAML texts as specs, and what is wrong with them."""

from pathlib import Path

import pytest

from kickbench.config.load import load
from kickbench.errors import SpecError


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

    def complaints(model, text: str, *overrides: str) -> list[str]:
        with pytest.raises(SpecError) as error:
            read(model, text, *overrides)
        return [str(problem) for problem in error.value.problems]

    return complaints
