"""A place to break specifications in: copies of the shipped ones."""

import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A working directory with `assets/`, `tasks/` and `methods/` as shipped."""
    for name in ("assets", "tasks", "methods"):
        shutil.copytree(ROOT / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def edit(place):
    """`edit(file, old, new)` replaces a text that must be there once; returns the file's new lines."""

    def edit(file: str, old: str, new: str) -> list[str]:
        path = Path(place, file)
        text = path.read_text()
        assert text.count(old) == 1, f"{file} has {old!r} {text.count(old)} times"
        path.write_text(text.replace(old, new))
        return path.read_text().splitlines()

    return edit
