"""Runs that a repository keeps: two tables thinned, everything else as it was, and still intact."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kickbench.errors import KickbenchError
from kickbench.results.episode_table import EpisodeSides, read_episodes, write_episodes
from kickbench.results.identity import read_identity
from kickbench.results.integrity import damage, read_sums, seal
from kickbench.results.metrics import load_metrics
from kickbench.results.progress_table import read_progress
from kickbench.results.provenance import InitialRef
from kickbench.results.store import RunDirectory
from kickbench.results.summary import summarise_sides
from kickbench.training.trained import load_run

from ..made_up import write_metrics
from ..support import assert_same_bits

RESULTS = Path(__file__).parents[2] / "results"
MEASURED = RESULTS / "measured/mini_home_field/baseline/seed0"
COUNT = 1000

spec = importlib.util.spec_from_file_location("keep", RESULTS / "keep.py")
assert spec is not None
assert spec.loader is not None
script = importlib.util.module_from_spec(spec)
spec.loader.exec_module(script)
keep = script.keep


@pytest.fixture
def run(tmp_path) -> Path:
    """A whole run: a measured one with more episodes and all rows of a training of 13 iterations."""
    path = Path(shutil.copytree(MEASURED, tmp_path / "runs/baseline/seed0"))
    home, mirrored = read_episodes(path / "episodes.csv.gz")
    assert mirrored is not None
    rows = np.resize(np.arange(len(home)), COUNT)
    many = [side.take(rows).reset_index(drop=True) for side in (home, mirrored)]
    (path / "episodes.csv.gz").unlink()
    (path / "progress.csv.gz").unlink()
    write_episodes(path / "episodes.csv", EpisodeSides(*many))
    (path / "progress.csv").write_text("iteration,a\n" + "".join(f"{i},{i / 7:.6g}\n" for i in range(13)))
    metrics = load_metrics(path / "metrics.json")
    evaluation = summarise_sides(EpisodeSides(*many), 0.02)
    write_metrics(path / "metrics.json", metrics.model_copy(update={"evaluation": evaluation}))
    seal(path)
    return path


def files_of(run: Path) -> set[str]:
    """All but the sums themselves."""
    files = {str(file.relative_to(run)) for file in run.rglob("*") if file.is_file()}
    return files - {"SHA256SUMS"}


def test_every_file_of_a_kept_run_has_its_sum():
    for metrics in (RESULTS / "measured").rglob("metrics.json"):
        assert read_sums(metrics.parent).keys() == files_of(metrics.parent), metrics.parent


def test_every_kth_episode_of_both_sides_is_kept(run, tmp_path):
    (kept,) = keep(tmp_path / "runs", tmp_path / "kept")
    assert kept == tmp_path / "kept/baseline/seed0"
    for side, whole in zip(
        read_episodes(kept / "episodes.csv.gz"), read_episodes(run / "episodes.csv"), strict=True
    ):
        pd.testing.assert_frame_equal(side, whole[::5].reset_index(drop=True))
        assert len(side) == 200


@pytest.mark.parametrize(("every", "rows"), [(5, [0, 5, 10, 12]), (4, [0, 4, 8, 12]), (1, list(range(13)))])
def test_of_the_training_every_kth_row_and_the_last_are_kept_as_they_were(run, tmp_path, every, rows):
    (kept,) = keep(tmp_path / "runs", tmp_path / "kept", every)
    whole = read_progress(run / "progress.csv")
    found = read_progress(RunDirectory(kept).progress)
    pd.testing.assert_frame_equal(found, whole.loc[rows].reset_index(drop=True))


def test_a_kept_run_is_intact_and_can_be_kept_again(run, tmp_path):
    keep(run, tmp_path / "kept")
    assert damage(tmp_path / "kept") is None
    assert read_sums(tmp_path / "kept").keys() == files_of(tmp_path / "kept")
    keep(tmp_path / "kept", tmp_path / "again")
    assert damage(tmp_path / "again") is None
    for name in ("metrics.json", "policy.pt", "episodes.csv.gz", "progress.csv.gz"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "kept" / name).read_bytes()


def test_the_policy_that_a_run_began_with_is_left_to_the_run_it_is_of(run, tmp_path):
    began = RunDirectory(run).initial_policy
    shutil.copy(run / "policy.pt", began)
    seal(run)
    keep(run, tmp_path / "kept")
    assert damage(tmp_path / "kept") is None
    assert files_of(run) - {"progress.csv", "episodes.csv"} == {
        *(files_of(tmp_path / "kept") - {"progress.csv.gz", "episodes.csv.gz"}),
        str(began.relative_to(run)),
    }


def test_a_damaged_or_unfinished_run_is_not_kept(run, tmp_path):
    with pytest.raises(KickbenchError, match="finished runs"):
        keep(tmp_path / "kept", tmp_path / "nothing")
    text = (run / "progress.csv").read_text()
    (run / "progress.csv").write_text(text + "13,1\n")
    with pytest.raises(KickbenchError, match="damaged"):
        keep(run, tmp_path / "kept")
    (run / "metrics.json").unlink()
    with pytest.raises(KickbenchError, match="finished runs"):
        keep(run, tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


def test_a_place_that_holds_a_run_is_refused(run, tmp_path):
    keep(run, tmp_path / "kept")
    with pytest.raises(KickbenchError, match="holds a run"):
        keep(run, tmp_path / "kept")


WITH_CRITIC = RESULTS / "measured/mini_worlds/goal_baseline/seed0"


def test_of_a_study_the_first_seed_keeps_its_policy_and_none_its_critic(tmp_path):
    """That policy is as it was, and the file is half as large."""
    for seed in (0, 1):
        shutil.copytree(WITH_CRITIC, tmp_path / f"runs/own/seed{seed}")
    first, second = keep(tmp_path / "runs", tmp_path / "kept", small=True)
    assert damage(first) is damage(second) is None
    before, after = load_run(WITH_CRITIC).policy, load_run(first).policy
    assert_same_bits(before.network.state_dict(), after.network.state_dict())
    assert (first / "policy.pt").stat().st_size < 0.6 * (WITH_CRITIC / "policy.pt").stat().st_size
    assert files_of(second) == files_of(first) - {"policy.pt"}


def test_a_critic_that_another_run_began_with_stays(tmp_path):
    """`reproduce` would take the other run, whose identity covers the critic, for another experiment's."""
    source, run = (shutil.copytree(WITH_CRITIC, tmp_path / "runs" / name) for name in ("first", "second"))
    metrics = load_metrics(run / "metrics.json")
    labels = {key: getattr(metrics, key) for key in ("task", "method", "seed", "env_steps")}
    fingerprint = read_identity(source).fingerprint
    initial = InitialRef(**labels, fingerprint=fingerprint, policy="0", critic="1", std=None)
    origin = metrics.provenance.model_copy(update={"initial": initial, "seed": 1})
    write_metrics(run / "metrics.json", metrics.model_copy(update={"provenance": origin, "seed": 1}))
    seal(run)
    with pytest.raises(KickbenchError, match=r"first: \S+second began with .* its critic, which has to stay"):
        keep(tmp_path / "runs", tmp_path / "kept", small=True)
    assert not (tmp_path / "kept").exists()
