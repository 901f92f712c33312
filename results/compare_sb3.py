"""CPU-seconds of training: kickbench beside stable-baselines3, as ratios of turns taken in one process.

    pip install stable-baselines3
    python results/compare_sb3.py [--rounds 3] [--timesteps 0.005 0.01] [--json FILE]

Both train plain PPO (methods/lite/baseline.yaml) on the K1 of k1_lite: the same MuJoCo model, network, samples an
iteration, mini-batches and epochs, one thread. stable-baselines3 has a `DummyVecEnv` of 64 envs, each a loop over
`mj_step` with the same observations (noise included) and the 14 rewards in numpy. It does a little less: no observation
statistics, no adaptive learning rate, no randomised friction, and its value function sees the actor's observations.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import stable_baselines3
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

import kickbench
from kickbench.bench.measure import Iterations
from kickbench.results.atomic import atomic_write_text
from kickbench.results.provenance import cpu_name
from kickbench.trials.trial import Trial, load_trial

ROOT = Path(__file__).parents[1]
TASK, METHOD = ROOT / "tasks/k1_lite.yaml", ROOT / "methods/lite/baseline.yaml"
Variant, Call = tuple[str, float], Callable[[], object]
"""Who trains at which physics step, s; and its next iteration."""
NOISE = np.repeat([0.1, 0.2, 0.05, 0.03, 0.0, 0.01, 0.5, 0.0], [3, 3, 3, 3, 3, 22, 22, 22])
"""Sizes of the task's observation noise."""


class PlainKick(gymnasium.Env):
    """k1_lite as one writes it for `mj_step`, one robot an env."""

    def __init__(self, trial: Trial, seed: int) -> None:
        task, layout = trial.task, trial.task.scene.layout
        self.spec_, self.layout, self.model = task.spec, layout, task.scene.model
        self.data, self.rng = mujoco.MjData(self.model), np.random.default_rng(seed)
        scale = task.spec.simulation.control_interval
        self.weights = np.array([weight * scale for _, weight in task.rewards])
        self.joints, self.dofs, self.rotation = layout.joint_qpos, layout.joint_qvel, np.zeros(9)
        self.default = layout.default_qpos[self.joints]
        self.middle, self.half = layout.joint_range.mean(axis=1), np.diff(layout.joint_range)[:, 0] / 2
        self.arms = [layout.joint_names.index(f"A{side}_Shoulder_Pitch") for side in ("Left", "Right")]
        self.rolls = [layout.joint_names.index(f"{side}_Shoulder_Roll") for side in ("Left", "Right")]
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (task.width("actor"),), np.float32)
        self.action_space = gymnasium.spaces.Box(-100.0, 100.0, (self.model.nu,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        """Robot in its default pose, ball and target drawn from the task's regions."""
        sampling, ball = self.spec_.sampling, self.layout.ball_qpos
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.layout.default_qpos
        self.data.qpos[self.joints] += self.rng.uniform(-0.02, 0.02, len(self.joints))
        self.data.qpos[ball : ball + 2] = [
            self.rng.uniform(*region) for region in (sampling.ball.x, sampling.ball.y)
        ]
        mujoco.mj_forward(self.model, self.data)
        (near, far), (right, left) = sampling.target.polar()
        distance, angle = self.rng.uniform(near, far), self.rng.uniform(right, left)
        self.target = np.array([distance * np.cos(angle), distance * np.sin(angle), 0.0])
        self.action = self.before = np.zeros(self.model.nu)
        self.steps = self.contact = 0
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """One control step: substeps, observation, 14 rewards, endings."""
        self.before, self.action = self.action, action
        self.data.ctrl[:] = self.layout.default_target + self.layout.action_scale * action
        mujoco.mj_step(self.model, self.data, self.spec_.simulation.decimation)
        self.steps += 1
        observation = self._observe()
        reward, ended = self._judge()
        return observation, reward, ended, self.steps >= self.spec_.episode.max_steps, {}

    def _observe(self) -> np.ndarray:
        """The actor's fields of Table 3.2, with noise."""
        qpos, qvel, ball = self.data.qpos, self.data.qvel, self.layout.ball_qpos
        mujoco.mju_quat2Mat(self.rotation, qpos[3:7])
        self.to_base = self.rotation.reshape(3, 3).T
        self.offset = qpos[self.joints] - self.default
        fields = (
            self.to_base @ qvel[:3], qvel[3:6], -self.to_base[:, 2], self.to_base @ (qpos[ball : ball + 3] - qpos[:3]),
            self.to_base @ (self.target - qpos[:3]), self.offset, qvel[self.dofs], self.action,
        )  # fmt: skip
        noise = NOISE * self.rng.uniform(-1.0, 1.0, len(NOISE))
        return (np.concatenate(fields) + noise).astype(np.float32)

    def _judge(self) -> tuple[float, bool]:
        """The rewards of Table 4.1, weighted and added, and whether the episode is over."""
        qpos, qvel, sensed, layout = self.data.qpos, self.data.qvel, self.data.sensordata, self.layout
        place, speed_of = layout.ball_qpos, layout.ball_qvel
        ball, velocity, base = qpos[place : place + 2], qvel[speed_of : speed_of + 2], qvel[:2]
        on_floor = np.array([sensed[layout.contacts[f"{foot}_foot_floor"]].any() for foot in layout.feet])
        touch = bool(sensed[layout.contacts["robot_ball"]].any())
        self.contact += self.contact > 0 or touch
        to_target, to_ball = self.target[:2] - ball, ball - qpos[:2]
        distance, speed, pace = np.linalg.norm(to_target), np.linalg.norm(velocity), np.linalg.norm(base)
        stopped, passed = speed < 0.5, self.contact > self.spec_.episode.contact_window
        moves, tilt = self.contact > 0 and not stopped, np.arccos(np.clip(self.to_base[2, 2], -1.0, 1.0))
        approach = max(0.0, velocity @ to_target / max(speed * distance, 1e-9)) if moves else 0.0
        nearing = max(0.0, base @ to_ball / max(pace * np.linalg.norm(to_ball), 1e-9)) if pace > 0.1 else 0.0
        angles = qpos[self.joints]
        left, right = angles[self.arms]
        swing = np.exp(-1.0 / max((left + right) ** 2, 1e-9)) * (
            left * right > 0.0 and abs(left + right) > 2.0
        )
        soles = [sensed[layout.frames[f"{foot}_foot_vel"]][:2] for foot in layout.feet]
        fell, low = tilt > 1.2217, qpos[2] < 0.2
        terms = (
            np.exp(-distance / 0.9) * (passed and stopped), approach, nearing / (1.0 + max(0.0, velocity @ to_target)),
            not moves, 1.0, np.exp(-(tilt**2) / 0.1), fell, low, sensed[layout.contacts["body_floor"]].any(),
            (np.abs(angles - self.middle) > 0.9 * self.half).any(), np.square(self.action - self.before).sum(),
            (np.square(soles).sum(axis=1) * on_floor).sum(), swing,
            (1.0 - np.exp(-((self.offset[self.rolls] / 0.5) ** 2))).mean(),
        )  # fmt: skip
        return float(self.weights @ np.array(terms, dtype=float)), bool(
            fell or low or (passed and (stopped or touch))
        )


def stable(trial: Trial, envs: int) -> Call:
    """Training by stable-baselines3: each call is one iteration."""
    settings, network = trial.method.spec.algorithm, trial.method.spec.network
    samples = settings.num_envs * settings.steps_per_env
    layers = {"pi": list(network.actor_hidden), "vf": list(network.critic_hidden)}
    look = {
        "net_arch": layers,
        "activation_fn": torch.nn.ELU,
        "log_std_init": float(np.log(network.initial_std)),
    }
    many = DummyVecEnv([lambda seed=seed: PlainKick(trial, seed) for seed in range(envs)])
    ppo = stable_baselines3.PPO(
        "MlpPolicy", many, settings.learning_rate, samples // envs, samples // settings.mini_batches, settings.epochs,
        settings.gamma, settings.gae_lambda, settings.clip, ent_coef=settings.entropy_coefficient,
        vf_coef=settings.value_coefficient, max_grad_norm=settings.max_gradient_norm, policy_kwargs=look, device="cpu",
    )  # fmt: skip
    return lambda: ppo.learn(samples, reset_num_timesteps=False)


def arguments() -> argparse.Namespace:
    """What the command line says."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    add = parser.add_argument
    add("--rounds", type=int, default=3, help="counted rounds (default: 3)")
    add("--timesteps", type=float, nargs="+", default=[0.005], help="physics steps, s (default: 0.005)")
    add("--envs", type=int, default=64, help="envs of stable-baselines3 (default: 64)")
    add("--warmup", type=int, default=6, help="kickbench's iterations before the first round (default: 6)")
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="as in `kickbench run`")
    add("--json", type=Path, help="write the figures here, too")
    return parser.parse_args()


def measure(calls: dict[Variant, Call], rounds: int) -> dict[Variant, np.ndarray]:
    """CPU-seconds of every variant in every round, one after the other."""
    taken = {variant: np.zeros(rounds) for variant in calls}
    for number in range(rounds):
        for (who, timestep), call in calls.items():
            before = time.process_time()  # of all threads together
            call()
            seconds = taken[who, timestep][number] = time.process_time() - before
            print(f"round {number}: {who} at {timestep} s: {seconds:.2f} CPU-seconds", file=sys.stderr)
    return taken


def spread(values: np.ndarray) -> dict[str, float]:
    """Median and extremes."""
    named = {"median": np.median(values), "least": values.min(), "most": values.max()}
    return {name: round(float(value), 4) for name, value in named.items()}


def main() -> None:
    """Measures and prints; see the module."""
    given, calls = arguments(), dict[Variant, Call]()
    torch.set_num_threads(1)
    for timestep in given.timesteps:
        trial = load_trial(TASK, METHOD, [*given.set, f"simulation.timestep={timestep}"])
        calls["kickbench", timestep] = Iterations(trial, "cpu", 1)
        calls["sb3", timestep] = stable(trial, given.envs)
        samples = trial.method.spec.algorithm.num_envs * trial.method.spec.algorithm.steps_per_env
    # Past the first falls: envs are then at all places of their episodes.
    for (who, _), call in calls.items():
        for _ in range(given.warmup if who == "kickbench" else 1):
            call()
    taken = measure(calls, given.rounds)
    modules = (kickbench, stable_baselines3, torch, mujoco)
    ratios = {
        f"kickbench at {own} s / sb3 at {other} s": spread(taken["kickbench", own] / taken["sb3", other])
        for own in given.timesteps
        for other in sorted({own, given.timesteps[0]})
    }
    figures = {
        "versions": {module.__name__: module.__version__ for module in modules},
        "python": platform.python_version(),
        "processor": cpu_name(),
        "samples": samples,
        "rounds": given.rounds,
        "cpu_seconds_per_1000_steps": {
            f"{who} at {timestep} s": spread(1000 * seconds / samples)
            for (who, timestep), seconds in taken.items()
        },
        "ratios": ratios,
    }
    print(json.dumps(figures, indent=2))
    for name, ratio in ratios.items():
        print(f"{name}: {ratio['median']:.2f} ({ratio['least']:.2f} to {ratio['most']:.2f})")
    if given.json:
        atomic_write_text(given.json, json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
