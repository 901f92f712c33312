"""The README's results are those of results/measured, to the letter."""

from __future__ import annotations

import shutil
from pathlib import Path
from xml.etree import ElementTree

import pytest

from kickbench.errors import KickbenchError
from kickbench.report.readme import (
    BEGIN,
    END,
    PICTURES,
    measured_results,
    pictures,
    replaced,
    section,
    summary,
    write_readme,
)
from kickbench.report.style import style

ROOT = Path(__file__).parents[2]
HINT = "results/measured and the README differ: run `kickbench report --readme`"


@pytest.fixture(scope="module")
def results():
    return measured_results(ROOT)


@pytest.fixture(scope="module")
def drawn(results):
    with style():
        return pictures(results)


def described(svg: str) -> tuple[str | None, str | None]:
    root = ElementTree.fromstring(svg)
    words = [element.text for element in root.iter() if element.tag.endswith("}description")]
    return root.findtext("{http://www.w3.org/2000/svg}title"), words[0]


def test_the_readme_is_up_to_date(results, drawn):
    for name, body in (
        ("README.md", summary(results, drawn)),
        ("results/README.md", section(results, drawn)),
    ):
        assert (ROOT / name).read_text() == replaced(ROOT / name, body), HINT


def test_the_readme_is_short(results, drawn):
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150
    lines = summary(results, drawn).splitlines()
    assert {line.count("|") - 1 for line in lines if line.startswith("|")} == {6}, "of either table"


def test_its_pictures_show_what_was_measured(results, drawn):
    """Compared by the figures in their descriptions, since their strokes depend on matplotlib's version."""
    for name, picture in drawn.items():
        stored = (ROOT / PICTURES / f"{name}.svg").read_text()
        assert described(stored) == (picture.title, picture.words), HINT
        assert f"pictures/{name}.svg)" in section(results, drawn) + summary(results, drawn)


def test_results_on_further_tasks_are_told(results, drawn):
    rows = [line for line in section(results, drawn).splitlines() if "| k1_lite_home_field |" in line]
    assert [row.split(" |")[0] for row in rows] == [
        f"| {arm} (seed 0)" for arm in ("baseline", "augmentation", "equivariant")
    ]


def test_iterations_and_hardware_stand_beside_every_figure(results, drawn):
    for line in section(results, drawn).splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and cells[0] not in ("Method", "Run", "---") and "(seed" not in cells[0]:
            iterations, hardware = cells[-5], cells[-2]
            assert iterations[0].isdigit()
            assert "thread" in hardware


def test_writing_twice_changes_nothing(tmp_path):
    for name in ("results/reported", "results/measured/mini_home_field", "tasks", "methods", "assets"):
        shutil.copytree(ROOT / name, tmp_path / name)
    readme, more = tmp_path / "README.md", tmp_path / "results/README.md"
    for file in (readme, more):
        file.write_text(f"before\n\n{BEGIN}\n\nold\n\n{END}\n\nafter\n")
    files = write_readme(tmp_path)
    first = [file.read_bytes() for file in files]
    assert write_readme(tmp_path) == files
    assert [file.read_bytes() for file in files] == first
    text = readme.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert "| mini_home_field | baseline | 5 | 48.4 ± 13.6 | 20.2 ± 10.3 |" in text
    assert "| baseline | mirrored | 20.2 ± 10.3" in more.read_text()


@pytest.mark.parametrize("readme", ["", BEGIN, END, f"{END}\n{BEGIN}", f"{BEGIN}\n{END}\n{BEGIN}\n{END}"])
def test_a_readme_without_the_marks_is_an_error(tmp_path, readme):
    (tmp_path / "README.md").write_text(readme)
    with pytest.raises(KickbenchError, match=r"README.md: expected, each once"):
        replaced(tmp_path / "README.md", "body")


def test_claims_that_cannot_be_judged_are_an_error(monkeypatch):
    def refuse(*_):
        raise KickbenchError("progress.csv: damaged")

    monkeypatch.setattr("kickbench.report.study.judge", refuse)
    with pytest.raises(KickbenchError, match=r"progress\.csv: damaged"):
        measured_results(ROOT)


def test_without_results_nothing_is_written(tmp_path):
    (tmp_path / "README.md").write_text(f"{BEGIN}\n{END}\n")
    with pytest.raises(KickbenchError, match="no results"):
        write_readme(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["README.md"]
