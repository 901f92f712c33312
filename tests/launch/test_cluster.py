"""What a node of a cluster does with a run, done here: everything but Ray."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.errors import KickbenchError
from kickbench.launch.cluster import Files, _content, _packed, _perform_there, _sent, _unpack
from kickbench.launch.local import perform
from kickbench.launch.plan import PlannedRun, make_plan
from kickbench.results.metrics import load_metrics
from kickbench.results.provenance import package_versions

from ..support import assert_same_run
from .conftest import TINY, tiny_experiment

CONDITIONS = """
  first: {method: METHODS/baseline.yaml}
  second: {method: METHODS/baseline.yaml, init_from: first, init_std: 0.3}
"""


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    return tiny_experiment(tmp_path_factory.mktemp("experiment"), CONDITIONS, 2, "mini_general")


def runs_in(folder: Path, experiment) -> list[PlannedRun]:
    return list(make_plan(experiment, out=folder, overrides=TINY).runs)


@pytest.fixture(scope="module")
def here(tmp_path_factory, experiment) -> list[PlannedRun]:
    """Both runs, done as `local` does them."""
    runs = runs_in(tmp_path_factory.mktemp("here"), experiment)
    assert [perform(run) for run in runs] == ["", ""]
    return runs


def sent(run: PlannedRun, mark: Path, *, initial: Path | None = None, **versions: str) -> tuple[str, Files]:
    """Does a run as a node does that was sent it."""
    # By paths of files that were sent: nothing of the sender's may be read.
    away, files = _sent(run), _packed(initial, "initial") if initial else {}
    return _perform_there(away, _content(run, away), files, (mark, "text"), package_versions() | versions)


def test_a_run_that_comes_home_from_a_node_is_that_of_this_machine(here, experiment, tmp_path):
    (run, _) = runs_in(tmp_path / "home", experiment)
    failure, files = sent(run, tmp_path / "not there")
    assert failure == ""
    assert not run.directory.path.exists()
    _unpack(files, run.directory.path)
    assert run.missing_evaluations == ()
    assert_same_run(run.directory.path, here[0].directory.path)
    metrics = [load_metrics(each.directory.also("mini_general")) for each in (run, here[0])]
    assert metrics[0].evaluation == metrics[1].evaluation
    assert metrics[0].evaluated_setting == metrics[1].evaluated_setting == run.settings["mini_general"]


def test_a_run_on_a_node_that_sees_the_folder_lies_there_and_begins_with_the_policy(
    here, experiment, tmp_path
):
    mark = tmp_path / "mark"
    mark.write_text("text")
    run = runs_in(tmp_path, experiment)[1]
    assert sent(run, mark, initial=here[0].directory.path) == ("", {})
    assert_same_run(run.directory.path, here[1].directory.path)
    initial = load_metrics(run.directory.metrics).provenance.initial
    assert initial is not None
    assert (initial.seed, initial.std) == (0, 0.3)
    assert initial == load_metrics(here[1].directory.metrics).provenance.initial


def test_a_node_with_another_version_is_refused(experiment, tmp_path):
    (run, _) = runs_in(tmp_path, experiment)
    with pytest.raises(KickbenchError) as refusal:
        sent(run, tmp_path / "mark", torch="1.0")
    own = package_versions()["torch"]
    assert f"has torch {own}, here 1.0: results would not be comparable" in str(refusal.value)
    assert not run.directory.path.exists()


def test_a_node_that_a_shell_has_started_in_the_background_hears_ctrl_c(experiment, tmp_path):
    (run, _) = runs_in(tmp_path, experiment)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as such a shell does
    try:
        with pytest.raises(KickbenchError):
            sent(run, tmp_path / "mark", torch="1.0")
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_node_that_compiles_another_task_from_the_files_refuses_it(experiment, tmp_path):
    (run, _) = runs_in(tmp_path, experiment)
    away = _sent(run)
    content = _content(run, away)
    content["own/specs/task.yaml"] = content["own/specs/task.yaml"].replace(
        b"max_steps: 20", b"max_steps: 21"
    )
    with pytest.raises(KickbenchError, match="compiles another trial from the same files: task: "):
        _perform_there(away, content, {}, (tmp_path / "mark", "text"), package_versions())


def test_without_ray_the_extra_is_named_and_nothing_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "mini_home_field", "--on", "ray"]) == 2
    assert "pip install 'kickbench[ray]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
