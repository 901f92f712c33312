"""What the claims of the general experiment can decide at three seeds."""

from __future__ import annotations

from pathlib import Path

import pytest

from kickbench.results.power import rates
from kickbench.trials.experiment import load_experiment

ROOT = Path(__file__).parents[2]
GENERAL = ROOT / "results/reported/general.yaml"


@pytest.fixture(scope="module")
def simulated():
    return rates(load_experiment(GENERAL), draws=300)


def test_what_three_seeds_cannot_decide_says_so(simulated):
    claims = load_experiment(GENERAL).claims
    assert {name: claims[name].decidable for name in simulated} == {
        n: r.decides for n, r in simulated.items()
    }


def test_the_table_of_the_readme_is_that_of_the_simulation(simulated):
    """To what 300 draws leave open: five standard deviations of a share near one half."""
    rows = {}
    for line in (ROOT / "results/README.md").read_text().splitlines():
        cells = [cell.strip(" `") for cell in line.strip("|").split("|")]
        if len(cells) == 5 and cells[0] in simulated:
            rows[cells[0]] = [None if cell == "-" else float(cell) for cell in cells[1:4]]
    assert set(rows) == set(simulated)
    for name, found in simulated.items():
        for stated, share in zip(rows[name], (found.replication, found.equal, found.worse), strict=True):
            assert (stated is None) == (share is None)
            if stated is not None and share is not None:
                assert stated == pytest.approx(100 * share, abs=15), name


def test_more_seeds_decide_what_three_cannot():
    few = rates(load_experiment(GENERAL), draws=100)["baseline_as_reported"]
    ten = ["seeds=[0,1,2,3,4,5,6,7,8,9]", "claims.baseline_as_reported.bound=0.1"]
    many = rates(load_experiment(GENERAL, ten), draws=100)["baseline_as_reported"]
    assert few.replication < many.replication
    assert many.decides
