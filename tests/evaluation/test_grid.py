"""A goal grid: the same places for everyone, nothing random in them, and mirrored cells that agree."""

from __future__ import annotations

import json
import shutil
from itertools import product
from math import cos, sin
from pathlib import Path

import numpy as np
import pytest
import torch

from kickbench.cli import main
from kickbench.errors import SpecError
from kickbench.evaluation.grid import _without_chance, evaluate_grid, grid_of, grid_states
from kickbench.evaluation.rollouts import run_episodes
from kickbench.nets.actor_critic import build_actor
from kickbench.results.frame import load_runs
from kickbench.results.metrics import load_metrics
from kickbench.results.tables import render_grid

ROOT = Path(__file__).parents[2]
RUN = ROOT / "results/measured/mini_home_field/equivariant/seed0"
SHORT = "episode.max_steps=60"
RANDOM = (
    "randomization.action_delay={delay: [0.0, 0.04], hold_probability: 0.3}",
    "randomization.pushes={interval: [0.1, 0.4], duration: 0.1, force: [0.0, 30.0]}",
    "randomization.foot_friction={range: [0.3, 1.2]}",
    "observations.actor.base_lin_vel.noise=0.2",
    "evaluation.observation_noise=true",
    "evaluation.pushes=true",
)
LATE = "observations.actor.ball_position={{delay: {}}}"
SMALL = "evaluation.grid={ball: [[0.25, 0.1], [0.25, -0.1]], distance: [1.5, 1.0], angle: [0.3, 0.0, -0.3]}"


def kicker(chosen, seed: int = 0):
    """An untrained policy, loud enough to kick in many episodes."""
    torch.manual_seed(seed)
    actor = build_actor(chosen.method.spec, chosen.symmetry.groups["actor"], chosen.symmetry.actions).eval()
    return lambda observations: 6.0 * actor(observations)


def distances(cells) -> np.ndarray:
    """Mean distance of every cell [targets' distances, angles]."""
    angles = len({cell.angle for cell in cells})
    return np.array([cell.figures.mean_distance for cell in cells]).reshape(-1, angles)


@pytest.mark.parametrize("method", ["equivariant", "baseline"])
def test_mirrored_cells_agree_for_an_equivariant_policy_only(experiment, method):
    chosen = experiment("mini_general", method, SHORT)
    cells = evaluate_grid(chosen.task, kicker(chosen)).grid
    found = distances(cells)
    assert found.shape == (3, 5)
    assert np.allclose(found, found[:, ::-1], atol=2e-3) == (method == "equivariant")


def test_with_one_episode_a_place_nothing_is_random_and_with_more_the_robot_is(experiment):
    plain, random = (experiment("mini_general", "baseline", SHORT, SMALL, *more) for more in ((), RANDOM))
    policy = kicker(plain)
    expected = evaluate_grid(plain.task, policy)
    assert evaluate_grid(random.task, policy, seed=1) == expected
    lossy = experiment("mini_general", "baseline", SHORT, SMALL, LATE.format("[0.0, 0.2], dropout: 0.3"))
    late = experiment("mini_general", "baseline", SHORT, SMALL, LATE.format("0.1"))
    assert evaluate_grid(lossy.task, policy, seed=1) == evaluate_grid(late.task, policy, seed=2) != expected
    several = [evaluate_grid(random.task, policy, episodes=2, seed=seed) for seed in (1, 1, 2)]
    assert several[0] == several[1] != several[2]
    assert [cell.figures.episodes for cell in several[0].grid] == [4] * 6


def test_every_target_meets_every_ball_in_the_order_of_the_file(experiment):
    chosen = experiment("mini_general", "baseline", SHORT, SMALL)
    grid = grid_of(chosen.task)
    states = grid_states(chosen.task, grid, episodes=2, seed=0)
    table = run_episodes(chosen.task, kicker(chosen), states, 0)
    targets = product((1.5, 1.0), (0.3, 0.0, -0.3))
    rows = [(*ball, d * cos(a), d * sin(a)) for d, a in targets for ball in grid.ball for _ in range(2)]
    found = [table.start_ball_x, table.start_ball_y, table.target_x, table.target_y]
    np.testing.assert_allclose(np.stack(found, axis=1), rows)


@pytest.mark.parametrize("episodes", [1, 2])
def test_a_rolling_ball_heads_as_from_its_own_place_and_with_one_episode_in_the_middle(experiment, episodes):
    rolling = "sampling.ball={speed: [0.2, 0.4], direction: [0.1, 0.3]}"
    task = experiment("mini_general", "baseline", SMALL, rolling).task
    task = _without_chance(task) if episodes == 1 else task
    states, layout = grid_states(task, grid_of(task), episodes, 3), task.scene.layout
    ball = states.qpos[:, layout.ball_qpos : layout.ball_qpos + 2]
    moves = states.qvel[:, layout.ball_qvel : layout.ball_qvel + 2]
    turn = torch.atan2(moves[:, 1], moves[:, 0]) - torch.atan2(-ball[:, 1], -ball[:, 0])
    turn, speed = torch.atan2(turn.sin(), turn.cos()), moves.norm(dim=1)
    aside = 1e-9 if episodes == 1 else 0.1
    assert ((turn - 0.2).abs() <= aside).all()
    assert ((speed - 0.3).abs() <= aside).all()
    assert (speed.std() > 0.01) == (episodes > 1)


def test_the_posts_of_a_goal_stand_at_the_target_of_the_grid(experiment):
    task = experiment("mini_goal", "baseline", "evaluation.grid={distance: [1.5], angle: [0.0, 0.3]}").task
    states, goal = grid_states(task, grid_of(task), 1, 0), task.scene.layout.goal_qpos
    assert torch.equal(states.qpos[:, goal : goal + 2], states.target)
    assert states.target[:, 1].unique().tolist() == pytest.approx([0.0, 1.5 * sin(0.3)])


def test_a_cell_has_the_figures_of_its_episodes(experiment):
    chosen = experiment("mini_general", "baseline", SHORT, SMALL)
    policy = kicker(chosen)
    cell = evaluate_grid(chosen.task, policy).grid[4]
    assert (cell.distance, cell.angle, cell.figures.episodes) == (1.0, 0.0, 2)
    table = run_episodes(chosen.task, policy, grid_states(chosen.task, grid_of(chosen.task), 1, 0), 0)
    own = slice(8, 10)
    assert cell.figures.mean_distance == pytest.approx(table.distance[own].mean())
    assert cell.figures.success_rate == table.success[own].mean()
    assert cell.figures.kick.mean_launch_speed == pytest.approx(np.nanmean(table.launch_speed[own]))
    assert cell.figures.kick.mean_direction_error == pytest.approx(
        np.nanmean(np.abs(table.direction_error[own]))
    )


def test_without_a_touch_there_are_no_figures_of_the_kick(experiment):
    chosen = experiment("mini_general", "baseline", "episode.max_steps=3", SMALL)
    cells = evaluate_grid(chosen.task, lambda seen: torch.zeros(len(seen), 7)).grid
    assert {cell.figures.kick.mean_launch_speed for cell in cells} == {None}
    *_, launch, aim = render_grid("title", cells).split("\n\n")
    assert launch.split() == ["launch", "[m/s]", "1", *"----", "launch", "[m/s]", "1.5", *"----"]
    assert aim.startswith("aim error [deg]")


def test_balls_of_the_default_grid_lie_in_the_region_and_clear_of_the_robot(experiment, capsys):
    grid = grid_of(
        experiment("mini_general", "baseline", "sampling.ball={x: [0.0, 0.6], y: [-0.3, 0.3]}").task
    )
    assert (0.1, 0.0) not in grid.ball
    assert {x for x, _ in grid.ball} <= {0.1, 0.3, 0.5}
    assert {y for _, y in grid.ball} == {-0.2, 0.0, 0.2}
    assert f"{9 - len(grid.ball)} of 9 ball positions overlap the robot" in capsys.readouterr().err
    fixed = grid_of(
        experiment("mini_general", "baseline", "sampling.target={distance: 2.0, angle: 0.0}").task
    )
    assert (fixed.distance, fixed.angle) == ((2.0,), (0.0,))


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        ("{ball: [[0.3, 0.0], [0.0, 0.0]]}", "grid.ball.1: a ball at [0, 0] would overlap the robot"),
        ("{distance: [-1.0]}", "grid.distance.0"),
        ("{distance: [2.0, 2.0]}", "grid.distance"),
        ("{angle: []}", "grid.angle"),
        ("{angle: [45.0]}", "in radians"),
        ("{angels: [0.1]}", "did you mean 'angle'"),
    ],
)
def test_a_wrong_grid_is_an_error_at_its_key(experiment, grid, said):
    with pytest.raises(SpecError) as error:
        experiment("mini_general", "baseline", f"evaluation.grid={grid}")
    assert said in str(error.value)


def test_a_grid_changes_no_identity(experiment):
    from kickbench.results.identity import identity_of

    plain, other = (experiment("mini_general", "baseline", *more) for more in ((), (SMALL,)))
    assert identity_of(plain) == identity_of(other)


def test_eval_prints_the_grid_and_keeps_it_beside_the_run(tmp_path, capsys):
    run = Path(shutil.copytree(RUN, tmp_path / "run"))
    task = tmp_path / "few.yaml"
    task.write_text(f"extends: {ROOT}/tasks/mini_general.yaml\nevaluation:\n  grid: {SMALL.split('=')[1]}\n")
    assert main(["eval", str(run), "--task", str(task), "--grid", "--save"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("goal grid: few_grid: 12 episodes on 6 targets\n")
    assert "-17 deg  +0 deg  +17 deg  mean" in printed
    kept = load_metrics(run / "also/few_grid.json")
    assert main(["eval", str(run), "--task", str(task), "--grid", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(kept.model_dump_json())
    frame = load_runs(run)
    assert set(frame.evaluated_on) == {"mini_home_field", "few_grid"}
    assert set(frame.state) == {"finished"}
    assert main(["eval", str(run), "--save"]) == 2
