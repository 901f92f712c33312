"""The CPU engine against MuJoCo itself."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from kickbench.envs.engines import make_engine
from kickbench.sim.cpu import CpuEngine
from kickbench.sim.engine import ModelField, usable_cores
from kickbench.symmetry.torch_ops import Mirror

WORLDS = 8


@pytest.fixture(scope="module")
def task(experiment):
    return experiment("mini_general").task


def random_states(task, count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """States with the ball near the feet and everything moving, so that contacts occur."""
    rng = np.random.default_rng(seed)
    model, layout = task.scene.model, task.scene.layout
    qpos = np.tile(layout.default_qpos, (count, 1))
    hinges = [c.qpos for c in layout.coordinates if not c.free]
    qpos[:, hinges] += rng.uniform(-0.3, 0.3, (count, len(hinges)))
    ball = layout.ball_qpos
    qpos[:, ball : ball + 2] = rng.uniform((0.15, -0.3), (0.4, 0.3), (count, 2))
    qvel = rng.normal(0.0, 0.5, (count, model.nv))
    return torch.from_numpy(qpos), torch.from_numpy(qvel)


def random_targets(task, count: int, seed: int = 1) -> torch.Tensor:
    return torch.randn(count, task.scene.model.nu, generator=torch.Generator().manual_seed(seed)) * 0.6


def everywhere(count: int = WORLDS) -> torch.Tensor:
    return torch.ones(count, dtype=torch.bool)


def step_in_mujoco(task, qpos, qvel, target):
    """The same control step by MuJoCo's own loop: final data and contacts with the ball in any substep."""
    model = task.scene.model
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, target
    touched = set()
    for _ in range(task.spec.simulation.decimation):
        mujoco.mj_step(model, data)
        ball = model.geom("ball").id
        touched |= {g for c in data.contact for g in (c.geom1, c.geom2) if ball in (c.geom1, c.geom2)}
    mujoco.mj_forward(model, data)
    return data, {model.geom(g).name for g in touched} - {"ball", "floor"}


def test_a_control_step_equals_mujocos_own_loop(task):
    engine = make_engine(task, WORLDS)
    qpos, qvel = random_states(task, WORLDS)
    targets = random_targets(task, WORLDS)
    engine.reset(everywhere(), qpos, qvel)
    engine.step(targets)
    for world in range(WORLDS):
        data, _ = step_in_mujoco(task, qpos[world], qvel[world], targets[world])
        np.testing.assert_array_equal(engine.qpos[world].numpy(), data.qpos)
        np.testing.assert_array_equal(engine.qvel[world].numpy(), data.qvel)


def test_frame_sensors_describe_the_state_they_come_with(task):
    engine = make_engine(task, WORLDS)
    engine.reset(everywhere(), *random_states(task, WORLDS))
    for seed in range(5):
        engine.step(random_targets(task, WORLDS, seed))
        for world in range(WORLDS):
            data = mujoco.MjData(task.scene.model)
            data.qpos[:], data.qvel[:] = engine.qpos[world], engine.qvel[world]
            mujoco.mj_forward(task.scene.model, data)
            for channel, places in task.scene.layout.frames.items():
                np.testing.assert_allclose(
                    engine.sensors[world, places].numpy(),
                    data.sensordata[places],
                    atol=1e-12,
                    err_msg=channel,
                )


def test_a_contact_in_any_substep_is_latched(task):
    count = 64
    engine = make_engine(task, count)
    qpos, qvel = random_states(task, count)
    targets = random_targets(task, count)
    engine.reset(everywhere(count), qpos, qvel)
    engine.step(targets)
    layout = task.scene.layout
    seen = missed_by_last_substep = 0
    for world in range(count):
        data, touched = step_in_mujoco(task, qpos[world], qvel[world], targets[world])
        for side in ("left", "right"):
            found = engine.sensors[world, layout.contacts[f"{side}_foot_ball"]].max() > 0
            assert found == (f"robot/{side}_foot" in touched)
            seen += int(found)
        assert (engine.sensors[world, layout.contacts["robot_ball"]].max() > 0) == bool(touched)
        at_end = {task.scene.model.geom(g).name for c in data.contact for g in (c.geom1, c.geom2)}
        missed_by_last_substep += bool(touched) and not any("foot" in name for name in at_end)
    assert seen > 5, "the sample has kicks"
    assert missed_by_last_substep > 0, "and some of them are over before the control step is"


def test_a_reset_touches_no_other_world_and_clears_contacts(task):
    engine = make_engine(task, WORLDS)
    engine.reset(everywhere(), *random_states(task, WORLDS))
    engine.step(random_targets(task, WORLDS))
    before = engine.qpos.clone(), engine.qvel.clone(), engine.sensors.clone()
    mask = torch.arange(WORLDS) % 2 == 0
    qpos, qvel = random_states(task, WORLDS, seed=5)
    engine.reset(mask, qpos, qvel)
    for now, old in zip((engine.qpos, engine.qvel, engine.sensors), before, strict=True):
        torch.testing.assert_close(now[~mask], old[~mask], rtol=0, atol=0)
    torch.testing.assert_close(engine.qpos[mask], qpos[mask], rtol=0, atol=0)
    places = np.concatenate(list(task.scene.layout.contacts.values()))
    assert (engine.sensors[mask][:, places] == 0).all()


def test_every_substep_has_its_own_control(task):
    decimation = task.spec.simulation.decimation
    engine, reference = make_engine(task, 1), make_engine(task, 1)
    schedule = torch.randn(1, decimation, task.scene.model.nu) * 0.5
    engine.step(schedule)
    reference.step(schedule[:, 0])
    assert not torch.equal(engine.qvel, reference.qvel)
    data = mujoco.MjData(task.scene.model)
    for k in range(decimation):
        data.ctrl[:] = schedule[0, k]
        mujoco.mj_step(task.scene.model, data)
    np.testing.assert_array_equal(engine.qvel[0].numpy(), data.qvel)


def test_the_number_of_threads_changes_nothing(task):
    results = []
    for threads in (1, 2, 3):
        engine = make_engine(task, WORLDS, num_threads=threads)
        engine.reset(everywhere(), *random_states(task, WORLDS))
        for seed in range(4):
            engine.step(random_targets(task, WORLDS, seed))
        results.append((engine.qpos.clone(), engine.sensors.clone()))
    for other in results[1:]:
        torch.testing.assert_close(other, results[0], rtol=0, atol=0)


def test_a_field_is_set_in_the_masked_worlds_and_given_rows_only(task):
    engine, compiled = make_engine(task, WORLDS), task.scene.model
    mask, ids = torch.arange(WORLDS) < 3, torch.as_tensor(np.concatenate(task.scene.layout.foot_geoms))
    friction = torch.rand(WORLDS, len(ids), dtype=torch.float64)
    inertia = torch.rand(WORLDS, 2, 3, dtype=torch.float64)
    fields = [
        ModelField("geom_friction", ids, friction, column=0),
        ModelField("body_inertia", torch.tensor([1, 2]), inertia),
    ]
    before = compiled.geom_friction.copy(), compiled.body_inertia.copy()
    engine.set_model(mask, fields)
    expected = np.stack([before[0]] * WORLDS), np.stack([before[1]] * WORLDS)
    expected[0][:3, ids.numpy(), 0] = friction[:3]
    expected[1][:3, [1, 2]] = inertia[:3]
    np.testing.assert_array_equal(engine.model_field("geom_friction"), expected[0])
    np.testing.assert_array_equal(engine.model_field("body_inertia"), expected[1])
    np.testing.assert_array_equal(compiled.geom_friction, before[0], "the shared model is untouched")


BOXES = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="0 0 1" friction="0.1 0 0"/>
  <body pos="0 0 0.05"><freejoint/><geom name="box" type="box" size=".05 .05 .05" priority="1"/></body>
  </worldbody></mujoco>"""


def test_friction_of_a_world_acts_in_that_world():
    """Two boxes slide on frictions of their own."""
    model = mujoco.MjModel.from_xml_string(BOXES)
    engine = CpuEngine(model, 2, 10)
    qpos, qvel = engine.qpos.clone(), engine.qvel.clone()
    qvel[:, 0] = 1.0
    engine.reset(everywhere(2), qpos, qvel)
    box = torch.tensor([model.geom("box").id])
    engine.set_model(
        everywhere(2), [ModelField("geom_friction", box, torch.tensor([[0.2], [0.8]]), column=0)]
    )
    for _ in range(5):
        engine.step(torch.zeros(2, 0))
    slowed = (1.0 - engine.qvel[:, 0]).numpy()
    np.testing.assert_allclose(slowed, np.array([0.2, 0.8]) * 9.81 * 0.1, rtol=0.1)


def test_what_mujoco_derives_from_masses_follows_them():
    model = mujoco.MjModel.from_xml_string(BOXES)
    engine = CpuEngine(model, 2, 10)
    mass = model.body_mass[1] * torch.tensor([[1.0], [3.0]], dtype=torch.float64)
    engine.set_model(everywhere(2), [ModelField("body_mass", torch.tensor([1]), mass)])
    np.testing.assert_allclose(engine.model_field("body_subtreemass")[:, 1], mass[:, 0])
    weights = engine.model_field("dof_invweight0")[:, 0]
    assert weights[0] == pytest.approx(3.0 * weights[1])


def test_a_world_with_bad_numbers_is_reported_and_can_be_reset(task):
    engine = make_engine(task, WORLDS)
    qpos, qvel = random_states(task, WORLDS)
    bad = qvel.clone()
    bad[2, 0], bad[5, 3] = float("nan"), 1e12
    engine.reset(everywhere(), qpos, bad)
    engine.step(random_targets(task, WORLDS))
    assert engine.failed.tolist() == [world in (2, 5) for world in range(WORLDS)]
    engine.reset(engine.failed.clone(), qpos, qvel)
    assert not engine.failed.any()
    engine.step(random_targets(task, WORLDS))
    assert not engine.failed.any()
    assert torch.isfinite(engine.sensors).all()


def test_mirrored_states_and_controls_give_the_mirrored_steps(experiment):
    chosen = experiment("mini_general", "equivariant")
    symmetry, task = chosen.symmetry, chosen.task
    qpos_map, qvel_map, action_map = Mirror(symmetry.qpos), Mirror(symmetry.qvel), Mirror(symmetry.actions)
    count = 64
    engine, image = make_engine(task, count), make_engine(task, count)
    qpos, qvel = random_states(task, count)
    engine.reset(everywhere(count), qpos, qvel)
    image.reset(everywhere(count), qpos_map(qpos), qvel_map(qvel))
    for seed in range(20):
        targets = random_targets(task, count, seed)
        engine.step(targets)
        image.step(action_map(targets))
    # Double precision, 20 control steps with contacts: what is left is rounding.
    torch.testing.assert_close(image.qpos, qpos_map(engine.qpos), rtol=0, atol=1e-9)
    torch.testing.assert_close(image.qvel, qvel_map(engine.qvel), rtol=0, atol=1e-7)


def test_usable_cores_follow_the_affinity(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 3, 5}, raising=False)
    assert usable_cores() == 3


def test_the_shared_model_is_not_changed_by_the_quiet_copy(task):
    model = task.scene.model
    before = model.sensor_needstage.copy()
    engine = make_engine(task, 2)
    engine.set_model(
        torch.ones(2, dtype=torch.bool),
        [ModelField("geom_friction", torch.tensor([1]), torch.full((2, 1), 0.123), column=0)],
    )
    np.testing.assert_array_equal(model.sensor_needstage, before)
    assert model.geom_friction[1, 0] != 0.123


def test_a_push_acts_on_its_body_in_its_world_until_changed():
    xml = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
      <body name="a"><freejoint/><geom size=".1" mass="2"/></body>
      <body name="b" pos="1 0 0"><freejoint/><geom size=".1" mass="4"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    engine = CpuEngine(model, 2, 10, pushed_body=model.body("b").id)
    engine.push(torch.tensor([[0.0, 8.0, 0.0], [0.0, 0.0, 0.0]]))
    for _ in range(5):
        engine.step(torch.zeros(2, 0))
    np.testing.assert_allclose(engine.qvel[0, 6:9], [0.0, 8.0 / 4.0 * 0.1, 0.0], atol=1e-9)
    assert (engine.qvel[0, :6] == 0).all()
    assert (engine.qvel[1] == 0).all()
    engine.push(torch.zeros(2, 3))
    before = engine.qvel.clone()
    engine.step(torch.zeros(2, 0))
    torch.testing.assert_close(engine.qvel, before)


def test_an_explosion_in_the_last_substep_is_seen_though_its_numbers_are_finite(task):
    engine = make_engine(task, WORLDS)
    qpos, qvel = random_states(task, WORLDS)
    engine.reset(everywhere(), qpos, qvel)
    engine.step(random_targets(task, WORLDS))
    engine._state[3, 1 + task.scene.model.nq] = 1e37
    engine._find_failures()
    assert engine.failed.tolist() == [world == 3 for world in range(WORLDS)]


def test_an_explosion_leaves_no_log_file_where_one_works(task, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    engine = make_engine(task, WORLDS)
    qpos, qvel = random_states(task, WORLDS)
    qvel[3] = 1e37
    engine.reset(everywhere(), qpos, qvel)
    engine.step(random_targets(task, WORLDS))
    assert engine.failed[3]
    assert not list(tmp_path.iterdir())
