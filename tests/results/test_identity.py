"""What a run's identity depends on, and what it does not; the model that a run keeps."""

from __future__ import annotations

import json
import os
import shutil
import time
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from kickbench.errors import KickbenchError, SpecError
from kickbench.results import specs
from kickbench.results.identity import Identity, identity_of, read_identity, write_identity
from kickbench.results.metrics import load_metrics
from kickbench.results.specs import stored_experiment, write_specs
from kickbench.results.store import RunDirectory
from kickbench.training.resume import begin
from kickbench.trials.trial import load_trial

ROOT = Path(__file__).parents[2]
METHOD = ROOT / "methods/mini/equivariant.yaml"
MEASURED = ROOT / "results/measured"
RUNS = sorted(path.parent for path in MEASURED.rglob("metrics.json"))
CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def robot(tmp_path) -> Path:
    """A folder with a copy of the mini kicker."""
    return Path(shutil.copytree(ROOT / "assets/mini_kicker", tmp_path / "robot"))


def edit(robot: Path, old: str, new: str, file: str = "mini_kicker.xml", encoding: str = "utf-8") -> None:
    text = (robot / file).read_text()
    assert old in text
    (robot / file).write_bytes(text.replace(old, new, 1).encode(encoding))


def experiment(robot: Path, *overrides: str):
    task = robot / "task.yaml"
    task.write_text(f"extends: {ROOT}/tasks/mini_home_field.yaml\nrobot: robot.yaml\n")
    return load_trial(task, METHOD, overrides)


def identity(robot: Path, *overrides: str) -> Identity:
    return identity_of(experiment(robot, *overrides))


def changed(one: Identity, other: Identity) -> set[str]:
    assert (one.fingerprint == other.fingerprint) == (one.parts == other.parts)
    return {part for part in one.parts if one.parts[part] != other.parts[part]}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<worldbody>", "<!-- a comment --><worldbody>"),
        ('rgba="0.85 0.87 0.90 1"', 'rgba="1 0 0 1"'),
        ("<worldbody>", '<worldbody><light pos="0 0 3"/><camera name="c"/>'),
        ('<geom name="visor"', '<site name="mark"/><geom name="visor"'),
        ('<geom name="visor"', '<geom size=".1" contype="0" conaffinity="0" mass="0"/><geom name="visor"'),
        ('name="visor"', 'name="hat"'),
        ("\n", "\r\n"),
    ],
    ids=["comment", "colour", "light", "site", "visual geom", "visual name", "line end"],
)
def test_what_nothing_moves_by_does_not_change_it(robot, old, new):
    before = identity(robot)
    edit(robot, old, new)
    assert identity(robot) == before


@pytest.mark.parametrize(
    ("old", "new", "array"),
    [
        ('mass="4.0"', 'mass="4.01"', "body_mass"),
        ('size="0.07 0.12 0.10" pos="0 0 0.12"', 'size="0.07 0.12 0.10" pos="0 0 0.121"', "body_ipos"),
        ("<worldbody>", '<default><joint armature="0.02"/></default><worldbody>', "dof_armature"),
    ],
)
def test_what_it_moves_by_changes_it_and_is_named(robot, old, new, array):
    before = identity(robot)
    edit(robot, old, new)
    after = identity(robot)
    assert changed(before, after) == {"model"}
    assert before.model_arrays[array] != after.model_arrays[array]


@pytest.mark.parametrize(
    ("override", "parts"),
    [
        ("algorithm.iterations=7", set()),
        ("simulation.jacobian=sparse", set()),
        ("simulation.max_contacts=9", set()),
        ("description=other", set()),
        ("algorithm.gamma=0.99", set()),
        ("network.residual_scale=null", set()),
        ("algorithm.gamma=0.9", {"method"}),
        ("rewards.action_rate.weight=-0.5", {"task"}),
        ("evaluation.episodes=9", {"task"}),
        ("ball.mass=0.2", {"task", "model"}),
    ],
)
def test_specs_count_by_what_they_mean(robot, override, parts):
    assert changed(identity(robot), identity(robot, override)) == parts


def test_the_order_of_terms_counts_and_that_of_other_keys_does_not(tmp_path):
    base = load_trial(ROOT / "tasks/mini_home_field.yaml", METHOD).loaded_task.document.data
    for name, data in {
        "same.yaml": dict(reversed(base.items())),
        "other.yaml": {**base, "rewards": dict(reversed(base["rewards"].items()))},
    }.items():
        data = {**data, "robot": str(ROOT / "assets/mini_kicker/robot.yaml")}
        (tmp_path / name).write_text(json.dumps(data))
    before = identity_of(load_trial(ROOT / "tasks/mini_home_field.yaml", METHOD))
    assert identity_of(load_trial(tmp_path / "same.yaml", METHOD)) == before
    assert changed(before, identity_of(load_trial(tmp_path / "other.yaml", METHOD))) == {"task"}


def test_an_identity_is_read_as_written_and_a_changed_one_is_refused(robot, tmp_path):
    before = identity(robot)
    write_identity(tmp_path, before)
    assert read_identity(tmp_path) == before
    file = tmp_path / "identity.json"
    file.write_text("{}")
    with pytest.raises(KickbenchError, match="damaged or of another version"):
        read_identity(tmp_path)
    file.unlink()
    with pytest.raises(KickbenchError, match="missing"):
        read_identity(tmp_path)


def of_many_files(robot: Path) -> None:
    """Splits the mini kicker: an include in an include, a mesh above the MJCF, a texture, an attached model with an
    include and a mesh of its own."""
    for folder in ("mjcf/parts", "mjcf/deco/meshes", "meshes", "textures"):
        (robot / folder).mkdir(parents=True)
    xml = (robot / "mini_kicker.xml").read_text()
    start, end = xml.index("<worldbody>") + 11, xml.index("</worldbody>")
    body = xml[start:end].replace(
        '<geom name="visor"',
        '<geom type="mesh" mesh="cube" mass=".01"/><attach model="deco" body="hat" prefix="d_"/><geom name="visor"',
    )
    assets = (
        '<compiler meshdir="../meshes" texturedir="../textures"/><asset><mesh name="cube" file="cube.obj" '
        'scale=".01 .01 .01"/><texture name="t" type="2d" file="t.png"/>'
        '<model name="deco" file="deco/deco.xml"/></asset><worldbody>'
    )
    main = xml[:start].replace("<worldbody>", assets) + '<include file="parts/outer.xml"/>' + xml[end:]
    (robot / "mini_kicker.xml").unlink()
    (robot / "mjcf/kicker.xml").write_bytes(
        main.replace("<asset>", "<!-- Gerät --><asset>").encode("latin-1")
    )
    (robot / "mjcf/parts/outer.xml").write_text('<mujoco><include file="parts/inner.xml"/></mujoco>')
    (robot / "mjcf/parts/inner.xml").write_text(f"<mujoco>{body}</mujoco>")
    (robot / "mjcf/deco/deco.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh name="m" file="cube.obj" scale=".01 .01 .01"/></asset>'
        '<worldbody><body name="hat" pos="0 0 .2"><geom type="mesh" mesh="m" mass=".01"/></body></worldbody></mujoco>'
    )
    for folder in ("meshes", "mjcf/deco/meshes"):
        (robot / folder / "cube.obj").write_text(CUBE)
    Image.new("RGB", (4, 4)).save(robot / "textures/t.png")
    edit(robot, "model: mini_kicker.xml", "model: mjcf/kicker.xml", "robot.yaml")


def test_a_run_keeps_every_file_of_its_model_byte_by_byte(robot, tmp_path):
    of_many_files(robot)
    chosen = experiment(robot)
    run = RunDirectory(tmp_path / "run")
    write_specs(run, chosen)
    copied = {str(file.relative_to(run.model)) for file in run.model.rglob("*") if file.is_file()}
    assert copied == {
        *("mjcf/kicker.xml", "mjcf/parts/outer.xml", "mjcf/parts/inner.xml", "mjcf/deco/deco.xml"),
        *("mjcf/deco/meshes/cube.obj", "meshes/cube.obj", "textures/t.png"),
    }
    assert all((run.model / name).read_bytes() == (robot / name).read_bytes() for name in copied)
    before = identity_of(chosen)
    shutil.rmtree(robot)
    moved = RunDirectory(run.path.rename(tmp_path / "moved"))
    assert identity_of(stored_experiment(moved)) == before == read_identity(moved)


def test_a_change_in_any_file_of_a_model_changes_it(robot):
    of_many_files(robot)
    before = identity(robot)
    for file, old, new in (
        ("mjcf/parts/inner.xml", 'mass="4.0"', 'mass="4.1"'),
        ("mjcf/deco/deco.xml", 'pos="0 0 .2"', 'pos="0 0 .3"'),
        ("mjcf/deco/meshes/cube.obj", "v 1 0 0", "v 2 0 0"),
    ):
        edit(robot, old, new, file)
        os.utime(robot / file, (0, time.time() + 10))  # MuJoCo keeps what it has read, by whole seconds
        after = identity(robot)
        assert changed(before, after) == {"model"}, file
        before = after


def test_a_model_that_is_too_large_is_an_error_and_nothing_is_written(robot, tmp_path, monkeypatch):
    monkeypatch.setattr(specs, "_MODEL_SIZE", 100)
    with pytest.raises(SpecError, match=r"robot\.yaml:\d+:\d+: model: the model's 1 files have"):
        begin(RunDirectory(tmp_path / "run"), experiment(robot))
    assert not (tmp_path / "run").exists()


def test_a_model_with_an_absolute_path_is_an_error_and_nothing_is_left(robot, tmp_path):
    part = tmp_path / "part.xml"
    part.write_text('<mujoco><geom size=".01" mass=".01"/></mujoco>')
    edit(robot, '<geom name="visor"', f'<include file="{part}"/><geom name="visor"')
    run = RunDirectory(tmp_path / "run")
    with pytest.raises(
        SpecError, match=r"robot\.yaml:\d+:\d+: model: this model reads .*part\.xml by an absolute"
    ):
        begin(run, experiment(robot))
    assert not run.holds_a_run
    assert not list(run.path.rglob("*"))


@pytest.mark.parametrize("robot", ["k1_lite/baseline", "mini_home_field/equivariant"])
def test_a_run_planned_by_the_shipped_files_has_the_identity_of_the_recorded_one(robot, tmp_path):
    run = MEASURED / robot / "seed0"
    folder = {"k1_lite": "lite", "mini_home_field": "mini"}[run.parents[1].name]
    task, method = (
        ROOT / f"tasks/{run.parents[1].name}.yaml",
        ROOT / f"methods/{folder}/{run.parent.name}.yaml",
    )
    planned = load_trial(task, method)
    assert identity_of(planned) == read_identity(run)
    write_specs(RunDirectory(tmp_path / "run"), planned)
    stored = (tmp_path / "run/specs/representations.yaml").read_bytes()
    assert stored == (run / "specs/representations.yaml").read_bytes(), "in full"


def test_recorded_runs_keep_their_identity():
    """What was recorded stays comparable: code may change, but not what a run is."""
    by_contents: dict[tuple[bytes, ...], Identity] = {}
    assert RUNS
    for run in RUNS:
        contents = tuple(file.read_bytes() for file in sorted((run / "specs").rglob("*")) if file.is_file())
        initial = load_metrics(run / "metrics.json").provenance.initial
        if contents not in by_contents or initial:
            stored = stored_experiment(RunDirectory(run))
            by_contents[contents] = identity_of(replace(stored, initial_policy=initial and initial.policy))
        assert read_identity(run).recipe == by_contents[contents].recipe, run
        assert read_identity(run).model_arrays == by_contents[contents].model_arrays, run
        if initial is None or initial.critic is None:  # its critic has a part in the identity, too
            assert read_identity(run) == by_contents[contents], run
