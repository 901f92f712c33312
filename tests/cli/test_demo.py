from __future__ import annotations

import pytest

from kickbench.cli import main
from kickbench.results.frame import load_runs


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
