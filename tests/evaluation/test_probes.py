"""The kick in figures, computed by hand for a scripted ball; and the equivariance error over visited states."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, degrees, hypot, nan, sqrt
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from kickbench.evaluation.probes import (
    EVERY,
    LAUNCH_WINDOW,
    EquivarianceProbe,
    KickRecord,
    StateTrack,
    twin_distances,
)
from kickbench.evaluation.rollouts import (
    draw_initial_states,
    mirror_initial_states,
    run_episodes,
    run_sides,
)
from kickbench.nets.actor_critic import build_actor
from kickbench.results.metrics import EquivarianceError
from kickbench.symmetry.representation import REGULAR, SIGN, TRIVIAL
from kickbench.symmetry.torch_ops import Mirror

DT = 0.02
TARGET = (2.0, 0.5)
STOP_SPEED = 0.2
SEEN, DONE = TRIVIAL + SIGN + REGULAR, SIGN + REGULAR


@dataclass
class Instant:
    """The end of a control step: where base and ball are, how fast the ball is, whether they touched in it."""

    base: tuple[float, float] = (0.0, 0.0)
    ball: tuple[float, float] = (0.3, 0.1)
    velocity: tuple[float, float] = (0.0, 0.0)
    touch: bool = False
    failed: bool = False


def pair(x: float, y: float) -> torch.Tensor:
    """A vector in env 0 and its mirror image in env 1."""
    return torch.tensor([[x, y, 0.0], [x, -y, 0.0]])


def state_of(instant: Instant, count: int) -> SimpleNamespace:
    ball, velocity = pair(*instant.ball), pair(*instant.velocity)
    return SimpleNamespace(
        base_pos=pair(*instant.base),
        ball_pos=ball,
        ball_lin_vel=velocity,
        ball_ground_speed=velocity.norm(dim=1),
        ball_to_target=pair(*TARGET)[:, :2] - ball[:, :2],
        ball_contact=torch.tensor([instant.touch] * 2),
        episode=SimpleNamespace(contact_count=torch.tensor([count] * 2)),
    )


def record_of(*instants: Instant) -> KickRecord:
    """The record after an episode from the first instant on."""
    record, count = KickRecord.empty(2), 0
    before = state_of(instants[0], 0)
    for instant in instants[1:]:
        count += count > 0 or instant.touch
        state = state_of(instant, count)
        record.note(before, state, torch.tensor([instant.failed] * 2), DT)  # type: ignore[arg-type]
        before = state
    return record


def figures(*instants: Instant) -> tuple[float, float, float, float]:
    """Touches, walked after touch, launch speed and direction error of env 0."""
    columns = record_of(*instants).columns(STOP_SPEED)
    names = ("touches", "walked_after_touch", "launch_speed", "direction_error")
    touches, walked, speed, error = (float(columns[name][0]) for name in names)
    return touches, walked, speed, error


def test_touches_are_counted_when_contact_begins():
    still, touch = Instant(), Instant(touch=True)
    assert record_of(still, still, still).touches.tolist() == [0, 0]
    assert record_of(still, touch, touch, touch).touches.tolist() == [1, 1]
    assert record_of(still, touch, still, touch, touch, still, still, touch).touches.tolist() == [3, 3]


def test_walking_counts_towards_the_ball_and_after_the_step_of_the_first_touch_only():
    # The ball lies at (0.3, 0) from the base: u = (1, 0) until the base has moved.
    path = [
        Instant((0.0, 0.0), (1.0, 0.0)),
        Instant((0.2, 0.0), (1.0, 0.0)),  # before the touch
        Instant((0.3, 0.0), (1.0, 0.0), touch=True),  # in the step of the touch
        Instant((0.5, 0.3), (0.5, 1.3)),  # from (0.3, 0) towards (1, 0): 0.2
        Instant((0.4, 0.1), (0.5, 1.3)),  # from (0.5, 0.3), away from (0.5, 1.3): nothing
        Instant((0.7, 0.5), (0.5, 1.3)),  # from (0.4, 0.1) with u = (0.1, 1.2) / |.|
    ]
    _, walked, _, _ = figures(*path)
    assert walked == pytest.approx(0.2 + (0.3 * 0.1 + 0.4 * 1.2) / hypot(0.1, 1.2), abs=1e-6)


def test_the_launch_is_the_fastest_moment_soon_after_the_first_touch():
    late = round(LAUNCH_WINDOW / DT)
    rolling = [Instant(velocity=(0.4, 0.0))] * (late - 1)
    path = [
        Instant(),
        Instant(velocity=(9.0, 0.0)),  # before the touch
        Instant(ball=(0.3, 0.1), velocity=(0.5, 0.5), touch=True),
        Instant(ball=(0.4, 0.1), velocity=(1.5, 0.8)),
    ]
    _, _, speed, error = figures(*path, *rolling, Instant(velocity=(5.0, 0.0), touch=True))
    assert speed == pytest.approx(1.7)
    assert error == pytest.approx(atan2(0.8, 1.5) - atan2(0.4, 1.6), abs=1e-6)
    assert error > 0, "to the left of the target"
    _, _, speed, _ = figures(*path, *rolling[:-2], Instant(velocity=(5.0, 0.0), touch=True))
    assert speed == pytest.approx(5.0), "within the window it is still the kick"


def test_without_a_touch_nothing_is_launched_and_a_slow_ball_has_no_direction():
    touches, walked, speed, error = figures(Instant(), Instant(velocity=(1.0, 0.0)))
    assert (touches, walked) == (0, 0)
    assert (speed, error) == pytest.approx((nan, nan), nan_ok=True)
    slow = Instant(velocity=(0.9 * STOP_SPEED, 0.0), touch=True)
    touches, _, speed, error = figures(Instant(), slow)
    assert touches == 1
    assert (speed, error) == pytest.approx((0.9 * STOP_SPEED, nan), nan_ok=True)
    assert figures(Instant(), Instant(touch=True))[2] == 0.0


def test_the_mirror_image_has_the_same_figures_and_the_opposite_direction_error():
    kick = Instant((0.1, 0.05), (0.5, 0.2), (2.0, 1.1), touch=True)
    record = record_of(Instant(), kick, Instant((0.3, 0.1), (0.6, 0.2), (1.9, 1.0)))
    columns = record.columns(STOP_SPEED)
    assert columns["direction_error"][0] == -columns["direction_error"][1] != 0
    for name in ("touches", "walked_after_touch", "launch_speed"):
        assert columns[name][0] == columns[name][1] != 0, name


def test_a_state_that_is_not_finite_changes_nothing():
    kick = Instant(velocity=(1.0, 0.5), touch=True)
    bad = Instant((nan, nan), (nan, nan), (nan, nan), touch=True, failed=True)
    good = figures(Instant(), kick, Instant((0.1, 0.0)))
    assert figures(Instant(), kick, Instant((0.1, 0.0)), bad) == pytest.approx(good)


def test_records_are_cleared_and_taken_env_by_env():
    record = record_of(Instant(), Instant(velocity=(1.0, 0.5), touch=True), Instant((0.1, 0.0)))
    other = record.take(torch.tensor([1, 0, 1]))
    assert other.launch.tolist() == [record.launch[row].tolist() for row in (1, 0, 1)]
    other.reset(torch.tensor([True, False, False]))
    assert other.touches.tolist() == [0, 1, 1]
    assert other.walked_after_touch[0] == other.launch_speed[0] == 0
    assert (other.launch != 0).all(dim=1).tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("velocity", "angle"),
    [((0, 2), 90), ((0, -3), -90), ((2, 0), 0), ((-1, 1e-3), 179.943), ((-1, -1), -135)],
)
def test_directions_are_positive_to_the_left_of_the_target(velocity, angle):
    before_target = Instant(ball=(0.3, TARGET[1]), velocity=velocity, touch=True)
    assert degrees(figures(Instant(), before_target)[3]) == pytest.approx(angle, abs=1e-3)


def observe(n: int = 64, seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    return TensorDict({"actor": torch.randn(n, SEEN.dim, generator=generator)}, batch_size=[n])


def error_of(policy, observations: TensorDict, batches: int = 1) -> EquivarianceError:
    probe = EquivarianceProbe(policy, {"actor": SEEN}, DONE)
    for rows in torch.arange(len(observations)).chunk(batches):
        part, start = observations[rows], torch.zeros(len(rows), dtype=torch.long)
        probe(part, policy(part), start, torch.ones(len(rows), dtype=torch.bool))
    result = probe.result()
    assert result is not None
    return result


def linear(weight: torch.Tensor):
    return lambda observations: observations["actor"] @ weight.T


def random_weight(seed: int = 0) -> torch.Tensor:
    return torch.randn(DONE.dim, SEEN.dim, generator=torch.Generator().manual_seed(seed))


def matrices() -> tuple[torch.Tensor, torch.Tensor]:
    return tuple(torch.tensor(rep.matrix(), dtype=torch.float32) for rep in (SEEN, DONE))


def test_it_is_the_definition_evaluated_on_the_states():
    weight, observations = random_weight(), observe()
    see, act = matrices()
    answers = observations["actor"] @ weight.T
    answers_mirrored = (observations["actor"] @ see.T) @ weight.T
    difference = answers_mirrored - answers @ act.T
    result = error_of(linear(weight), observations)
    assert result.states == 64
    assert result.rms == pytest.approx(float(difference.square().mean().sqrt()), rel=1e-5)
    assert result.largest == pytest.approx(float(difference.abs().max()), rel=1e-5)
    size = (answers.square().mean() + answers_mirrored.square().mean()) / 2
    assert result.relative == pytest.approx(result.rms / sqrt(float(size)), rel=1e-5)


def test_symmetric_and_antisymmetric_policies_are_the_ends_of_the_range():
    weight = random_weight()
    see, act = matrices()
    image = act @ weight @ see
    assert error_of(linear(weight + image), observe()).relative < 1e-6
    assert error_of(linear(weight - image), observe()).relative == pytest.approx(2.0)
    assert 0.5 < error_of(linear(weight), observe()).relative < 1.9


def test_a_policy_that_never_acts_is_equivariant():
    assert error_of(linear(torch.zeros(DONE.dim, SEEN.dim)), observe()).relative == 0.0


def test_sums_over_batches_are_those_over_all():
    found = (error_of(linear(random_weight()), observe(), batches) for batches in (1, 7))
    whole, parts = (error.model_dump(exclude_none=True) for error in found)
    assert parts == pytest.approx(whole)


def test_mirrored_states_have_the_same_error():
    observations = observe()
    images = TensorDict({"actor": Mirror(SEEN)(observations["actor"])}, batch_size=[64])
    found = (error_of(linear(random_weight()), seen) for seen in (observations, images))
    here, there = (error.model_dump(exclude_none=True) for error in found)
    assert there == pytest.approx(here, rel=1e-5)


def test_only_every_few_steps_of_running_episodes_are_looked_at():
    calls: list[int] = []

    def policy(observations):
        calls.append(len(observations["actor"]))
        return linear(random_weight())(observations)

    probe = EquivarianceProbe(policy, {"actor": SEEN}, DONE)
    assert probe.result() is None
    observations = observe(4)
    steps, running = torch.tensor([0, 1, EVERY, 2 * EVERY]), torch.tensor([True, True, True, False])
    probe(observations, torch.zeros(4, DONE.dim), steps, running)
    result = probe.result()
    assert result is not None
    assert (result.states, calls) == (2, [2])
    probe(observations, torch.zeros(4, DONE.dim), steps + 1, torch.ones(4, dtype=torch.bool))
    assert calls == [2], "a step without a state to look at costs no pass"


def test_answers_that_are_not_finite_are_left_out():
    probe = EquivarianceProbe(linear(random_weight()), {"actor": SEEN}, DONE)
    actions = torch.zeros(4, DONE.dim)
    actions[1, 0] = nan
    probe(observe(4), actions, torch.zeros(4, dtype=torch.long), torch.ones(4, dtype=torch.bool))
    result = probe.result()
    assert result is not None
    assert result.states == 3


def twin_task(length: float = 1.0) -> SimpleNamespace:
    """What `StateTrack` asks of a task: control steps of 0.1 s."""
    simulation, episode = (
        SimpleNamespace(control_interval=0.1),
        SimpleNamespace(max_steps=round(length / 0.1)),
    )
    return SimpleNamespace(spec=SimpleNamespace(simulation=simulation, episode=episode))


def test_a_track_has_the_state_at_its_times_and_of_an_ended_episode_the_last_one():
    track = StateTrack(twin_task(), torch.zeros(3, 1).double())  # type: ignore[arg-type]
    assert track.times == [0.2, 0.5, 1.0]
    fine, running = torch.zeros(2, dtype=torch.bool), torch.tensor([0, 2])
    for step in range(1, 11):
        # Episode 0 runs to the end; episode 2 ends in step 3, and its env goes on with nothing.
        running[1] = 2 if step <= 3 else -1
        seen = torch.tensor([[1.0 * step], [100.0 + step]]).double()
        track.note(seen, torch.tensor([step, step]), running, fine)
    assert track.qpos[:, 0, 0].tolist() == [2, 5, 10]
    assert track.qpos[:, 2, 0].tolist() == [102, 103, 103]
    assert track.qpos[:, 1, 0].tolist() == [0, 0, 0], "an episode that never ran is where it began"
    track.note(seen * nan, torch.tensor([10, 10]), torch.tensor([0, 2]), ~fine)
    assert track.qpos.isfinite().all(), "a state that is not finite is not kept"


def test_times_beyond_the_longest_episode_are_left_out():
    assert StateTrack(twin_task(0.6), torch.zeros(1, 1)).times == [0.2, 0.5]  # type: ignore[arg-type]


def test_the_distance_of_twins_is_that_of_the_balls_and_joints_after_mirroring(experiment):
    task = experiment("mini_home_field", "baseline").task
    initial, layout = draw_initial_states(task, 10, 0), task.scene.layout
    home, away = StateTrack(task, initial.qpos), StateTrack(task, mirror_initial_states(task, initial).qpos)
    for of in twin_distances(task, home, away):
        assert max(of.ball_q90, of.joints_q90) < 1e-12, "exact mirror images"
    away.qpos[0, :, layout.ball_qpos + 1] += torch.linspace(0.0, 0.9, 10)
    away.qpos[0, :, layout.joint_qpos[0]] += 0.5
    first, second, *_ = twin_distances(task, home, away)
    assert (first.ball_median, first.ball_q90) == pytest.approx((0.45, 0.81))
    expected = 0.5 / sqrt(len(layout.joint_qpos))
    assert (first.joints_median, first.joints_q90) == pytest.approx((expected, expected))
    assert second.ball_q90 < 1e-12


@pytest.mark.parametrize("method", ["equivariant", "baseline"])
def test_twins_stay_together_under_an_equivariant_policy_only(experiment, method):
    chosen = experiment("mini_home_field", method, "episode.max_steps=60")
    torch.manual_seed(0)
    actor = build_actor(chosen.method.spec, chosen.symmetry.groups["actor"], chosen.symmetry.actions).eval()
    _, measured = run_sides(chosen.task, lambda seen: 6.0 * actor(seen), episodes=10)
    assert measured.equivariance is None
    assert [of.time for of in measured.twins] == [0.2, 0.5, 1.0]
    assert all((of.joints_median < 0.01) == (method == "equivariant") for of in measured.twins)


def probe_of(chosen, policy) -> EquivarianceProbe:
    tables = {name: table.representation for name, table in chosen.symmetry.groups.items()}
    return EquivarianceProbe(policy, tables, chosen.symmetry.actions)


@pytest.mark.parametrize("method", ["equivariant", "baseline"])
def test_over_episodes_it_tells_the_methods_apart_and_not_the_number_of_worlds(experiment, method):
    chosen = experiment("mini_home_field", method, "episode.max_steps=23")
    torch.manual_seed(0)
    actor = build_actor(chosen.method.spec, chosen.symmetry.groups["actor"], chosen.symmetry.actions).eval()
    results = []
    for worlds in (4, 20):
        probe = probe_of(chosen, actor)
        table = run_episodes(
            chosen.task, actor, draw_initial_states(chosen.task, 20, 0), 0, num_envs=worlds, probe=probe
        )
        result = probe.result()
        assert result is not None
        assert result.states == sum(-(-steps // EVERY) for steps in table.steps.tolist())
        results.append(result)
    few, many = (result.model_dump(exclude_none=True) for result in results)
    assert few == pytest.approx(many, rel=1e-3, abs=1e-6)
    assert (results[0].relative < 1e-5) == (method == "equivariant")
