"""`kickbench compare`: run directories in, the right figures under the right titles out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kickbench.cli import main
from kickbench.results.metrics import load_metrics
from kickbench.results.statistics import welch

from ..made_up import write_result
from .conftest import make_metrics, make_side


def write_run(folder: Path, method: str, seed: int, rate: float) -> float:
    """A run of about that success; exactly that much is returned."""
    rate = rate + 0.001 * ((7 * seed) % 5)
    sides = make_side(rate, 1 - rate), make_side(rate / 2, 1 - rate / 2)
    metrics = make_metrics(*sides, method, seed, task="a_task", iterations=450)
    write_result(folder / method / f"seed{seed}", metrics)
    return rate


def compare(folder: Path, capsys) -> str:
    assert main(["compare", str(folder)]) == 0
    return capsys.readouterr().out


def rows(text: str, start: str) -> list[list[str]]:
    return [line.split() for line in text.splitlines() if line.startswith(start)]


def test_methods_have_a_row_and_pairs_have_theirs(tmp_path, capsys) -> None:
    first = [100 * write_run(tmp_path, "a", seed, 0.9) for seed in range(3)]
    second = [100 * write_run(tmp_path, "b", 3 + seed, 0.3) for seed in range(3)]
    text = compare(tmp_path, capsys)
    assert text.startswith("task: a_task: success in distribution [%]\n")
    assert rows(text, "a ")[0] == ["a", "3", "450", f"{np.mean(first):.1f}", f"{np.std(first, ddof=1):.1f}"]
    difference, (low, high) = welch(first, second)
    expected = ["a", "-", "b", f"{difference:.1f}", f"[{low:.1f},", f"{high:.1f}]", "0.100", "0.100"]
    assert rows(text, "a - b")[0] == expected
    assert len(rows(text, "a - b")) == 5, "success, gap and distance, on both sides"


def test_one_seed_is_said_not_to_be_enough(tmp_path, capsys) -> None:
    write_run(tmp_path, "a", 0, 0.9)
    write_run(tmp_path, "b", 1, 0.3)
    text = compare(tmp_path, capsys)
    assert rows(text, "a ")[0][:4] == ["a", "1", "450", "90.0"]
    assert not rows(text, "a - b")
    assert "a: one seed; two are the least" in text


def test_a_copied_seed_counts_once(tmp_path, capsys) -> None:
    for seed in range(2):
        write_run(tmp_path / "one", "a", seed, 0.9)
        write_run(tmp_path / "one", "b", seed, 0.3)
    once = compare(tmp_path, capsys)
    write_run(tmp_path / "two", "a", 0, 0.9)
    text = compare(tmp_path, capsys)
    assert rows(text, "a ") == rows(once, "a ")
    (line,) = [line for line in text.splitlines() if line.startswith("left out: ")]
    assert line.endswith(f"as {tmp_path}/one/a/seed0")


def test_a_single_method_has_nothing_to_be_compared_with(tmp_path, capsys) -> None:
    write_run(tmp_path, "a", 0, 0.9)
    assert compare(tmp_path, capsys) == "no two methods of one task to compare\n"


def test_no_run_is_an_error(tmp_path, capsys) -> None:
    assert main(["compare", str(tmp_path)]) == 2
    assert "no finished run" in capsys.readouterr().err


def test_the_text_is_ascii_and_repeatable(tmp_path, capsys) -> None:
    for seed in range(3):
        write_run(tmp_path, "a", seed, 0.9)
        write_run(tmp_path, "b", seed, 0.8)
    text = compare(tmp_path, capsys)
    assert text.isascii()
    assert text == compare(tmp_path, capsys)


def test_a_method_without_a_figure_is_said_to_be_left_out_and_a_scaled_one_to_be_scaled(
    tmp_path, capsys
) -> None:
    for seed, method in enumerate("abc"):
        write_run(tmp_path, method, seed, 0.9)
    path = tmp_path / "c/seed2"
    metrics = load_metrics(path / "metrics.json")
    evaluation = metrics.evaluation.model_copy(update={"mirrored": None})
    write_result(path, metrics.model_copy(update={"evaluation": evaluation, "scale": 0.1}))
    text = compare(tmp_path, capsys)
    assert rows(text, "c ")[0][:4] == ["c", "1", "450", "scaled"]
    assert rows(text, "a ")[0][3] != "scaled"
    blocks = text.split("task: a_task: ")
    assert [block.split(" [")[0] for block in blocks if "c: left out" in block] == [
        "success mirrored",
        "success in distribution - mirrored",
        "mean distance mirrored",
    ]
    assert "c: left out, it has runs without this figure" in text


def test_p_values_are_adjusted_for_all_pairs_that_have_one(tmp_path, capsys) -> None:
    for method, rate, seeds in (("a", 0.9, 4), ("b", 0.3, 4), ("c", 0.6, 4), ("d", 0.5, 1)):
        for seed in range(seeds):
            write_run(tmp_path, method, seed, rate)
    text = compare(tmp_path, capsys)
    first = text[: text.index("success mirrored")]
    assert [row[-2:] for row in rows(first, "a - ")] == [["0.029", "0.086"]] * 2, "3 times 2/70"
    assert "d: one seed; two are the least" in first
