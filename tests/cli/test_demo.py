from __future__ import annotations

import pandas as pd
import pytest

from kickbench.cli import main
from kickbench.cli.train import sentence
from kickbench.results.frame import load_runs


def runs(**rates: tuple[float, float]) -> pd.DataFrame:
    """A table of runs with success at home and on the mirrored side."""
    rows = [
        {"method": method, "side": side, "success_rate": rate}
        for method, pair in rates.items()
        for side, rate in zip(("in_distribution", "mirrored"), pair, strict=True)
    ]
    return pd.DataFrame(rows)


def test_the_sentence_says_what_each_policy_loses():
    text = sentence(runs(baseline=(0.55, 0.05), augmentation=(0.7, 0.65), equivariant=(0.8, 0.795)))
    assert text.splitlines()[0] == (
        "The baseline policy fails on the side that it never saw: 55 -> 5 %; "
        "augmentation loses 5 points there: 70 -> 65 %; the equivariant policy loses nothing there: 80 -> 80 %."
    )


def test_a_policy_that_has_learned_nothing_is_not_said_to_lose_nothing():
    text = sentence(runs(baseline=(0.01, 0.01), augmentation=(0.7, 0.65), equivariant=(0.8, 0.8)))
    assert text.startswith("The baseline policy has not learned the task: 1 -> 1 %")


@pytest.mark.slow
def test_the_demo_trains_three_methods_and_ends_with_what_to_do_next(tmp_path, capfd):
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out), "--scale", "0.003"]) == 0
    printed = capfd.readouterr().out
    assert list(load_runs(out)[lambda r: r.side == "mirrored"].method) == [
        "augmentation",
        "baseline",
        "equivariant",
    ]
    assert "[3/3] equivariant/seed0: done" in printed
    assert f"kickbench play {out}/equivariant/seed0" in printed
    assert (out / "report.html").is_file()
    assert main(["demo", "--out", str(out), "--scale", "0.003"]) == 0, "nothing is trained again"
    assert "begins" not in capfd.readouterr().out
