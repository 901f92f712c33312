"""Experiments written when conditions were arms and transfer tasks were `also`: still read, with warnings."""

from __future__ import annotations

from pathlib import Path

import pytest

from kickbench.errors import SpecError
from kickbench.trials.experiment import load_experiment
from kickbench.trials.validate import check_files

ROOT = Path(__file__).parents[2]
OLD = sorted((Path(__file__).parent / "old_names").glob("*.yaml"))
HERE = Path(__file__).parent.relative_to(ROOT) / "old_names"


@pytest.mark.parametrize("file", OLD, ids=lambda file: file.stem)
def test_an_old_experiment_is_that_of_today(file):
    old, new = load_experiment(file), load_experiment(ROOT / f"results/reported/{file.name}")
    assert list(old.conditions) == list(new.conditions)
    assert [list(found.transfer) for found in old.conditions.values()] == [
        list(found.transfer) for found in new.conditions.values()
    ]
    assert old.claims == new.claims
    assert old.claims_hash == new.claims_hash


def test_hashes_of_claims_are_those_that_runs_have_recorded():
    """Computed before the names changed."""
    hashes = {
        "home_field_fast": "239042d1b0f3c56d52d6b18eb7ef9bfef165ab5fb6bcdd7745adeab10bb8dabd",
        "leg_preference": "b8ef1d944cf43ba8b63c9a3f949d68a88d9365eade9e4f68a7a6cee81c01abc9",
    }
    for name, expected in hashes.items():
        assert load_experiment(ROOT / f"results/reported/{name}.yaml").claims_hash == expected


def test_every_old_key_is_named_at_its_place(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / HERE / "home_field_fast.yaml").read_text().replace("../../../", f"{ROOT}/")
    Path("old.yaml").write_text(text)
    load_experiment("old.yaml", [f"arms.baseline.method={ROOT}/methods/equivariant.yaml"])
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "old.yaml:6:3: 'also' is now 'transfer'"
    assert lines[1] == "old.yaml:13:13: 'arm' is now 'condition'"
    assert lines[-1].startswith("--set arms.baseline.method=")
    assert lines[-1].endswith(": 'arms' is now 'conditions'")
    load_experiment(ROOT / "results/reported/home_field_fast.yaml")
    assert capsys.readouterr().err == ""


def test_a_problem_names_the_new_key(tmp_path, capsys):
    file = tmp_path / "a.yaml"
    file.write_text("seeds: [0]\narms: {a: {method: a.yaml, metod: b.yaml}}\n")
    with pytest.raises(SpecError) as error:
        load_experiment(file)
    assert f"{file}:2:28: conditions.a.metod: unknown key 'metod'" in str(error.value)


def test_an_old_and_a_new_key_together_are_an_error(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_text("seeds: [0]\narms: {}\nconditions: {}\n")
    with pytest.raises(SpecError, match="duplicate key 'conditions'"):
        load_experiment(file)


def test_an_override_by_an_old_name_fits_an_experiment(capsys):
    file = ROOT / "results/reported/mini_home_field.yaml"
    (report,) = check_files([file], ["arms.baseline.seeds=[3]"])
    assert (report.kind, report.problems) == ("experiment", [])
