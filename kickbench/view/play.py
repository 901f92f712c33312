"""A policy, live: one env stepped as in an evaluation, in real time, with controls."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np
import torch
from torch import Tensor

from kickbench.envs.compile import CompiledTask
from kickbench.envs.disturbances import EpisodeDraws
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.episode import FOOT_NAMES, Outcome
from kickbench.envs.initial_states import InitialStates
from kickbench.errors import KickbenchError
from kickbench.evaluation.episodes import Policy
from kickbench.nets.threads import torch_threads
from kickbench.results.episodes import NON_FINITE
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import state_symmetry
from kickbench.view.look import dress
from kickbench.view.outline import outlines
from kickbench.view.starts import evaluation_starts

_HOLD = 1.0
"""How long the end of an episode stays, s."""
_LAG = 0.25
"""Simulated time at most that is made up for at once, s: a slow machine shows slow motion."""


@dataclass
class Tally:
    """Episodes that ended, and those of them with the ball at rest in the target."""

    successes: int = 0
    episodes: int = 0

    def __str__(self) -> str:
        return f"{self.successes} of {self.episodes}"


class Session:
    """The running episode and the controls of a viewer.

    Initial state k is that of row k of `episodes.csv`, and what follows it is what the evaluation sees, noise included.

    Attributes:
        env: The env.
        number: Number of the initial state.
        mirrored: Whether the mirror image of it is shown.
        start: The initial state, one row.
        qpos: Generalised positions to show [nq].
        outcome: What the last step led to; None at an initial state.
        ending: Name of the termination of an episode that has just ended; empty while it runs.
        rewards: Weighted reward of each term in the last step and so far [2, R].
        tallies: Ended episodes from the initial states as drawn, and from their mirror images.
        paused: Whether time stands still.
        speed: Simulated over real time.
        repeat: Whether an episode is followed by one from the same initial state instead of the next.
    """

    def __init__(self, task: CompiledTask, policy: Policy | None, seed: int) -> None:
        """Begins the first episode.

        Args:
            task: Compiled task.
            policy: Deterministic policy; None: zero action.
            seed: Seed of the initial states, and of noise, delays and pushes where the task's evaluation has any.
        """
        protocol, self._policy, self._seed = task.spec.evaluation, policy, seed
        self._starts = evaluation_starts(task, protocol.episodes, seed)
        self._qpos, self._qvel = (Mirror(representation) for representation in state_symmetry(task))
        self._ball, self._dt = task.scene.layout.ball_qpos, task.spec.simulation.control_interval
        self.paused, self.repeat, self.mirrored, self.speed = False, False, False, 1.0
        self.tallies = (Tally(), Tally())
        self.number, self.start = 0, self._starts.take(torch.tensor([0]))
        self._draws = EpisodeDraws(1)
        self.env = KickEnv(
            task,
            make_engine(task, 1, num_threads=1),
            seed,
            noise=protocol.observation_noise,
            pushes=protocol.pushes,
            initial_states=self._hand_out,
            draws=self._draws,
        )
        self.restart()

    def _hand_out(self, mask: Tensor) -> InitialStates:
        if mask.any():
            self._draws.begin(0, (self._seed, self.number))
        return self.start

    @torch.inference_mode()
    def restart(self) -> None:
        """Begins the episode again."""
        self.env.reset()
        self.qpos = self.start.qpos[0].numpy().copy()
        self.outcome: Outcome | None = None
        self.ending, self._hold, self._credit = "", 0, 0.0
        self.rewards = np.zeros((2, len(self.env.task.rewards)))

    def show(self, number: int) -> None:
        """Begins an episode from another initial state."""
        self.number = number % len(self._starts)
        self.start = self._starts.take(torch.tensor([self.number]))
        if self.mirrored:
            self.start = self.start.mirrored(self._qpos, self._qvel)
        self.restart()

    def mirror(self) -> None:
        """Begins an episode from the mirror image of the initial state."""
        self.mirrored, self.start = not self.mirrored, self.start.mirrored(self._qpos, self._qvel)
        self.restart()

    @property
    def places(self) -> np.ndarray:
        """Ball and target of the initial state [4]: ball x, y, target x, y, m."""
        return np.append(self.start.qpos[0, self._ball : self._ball + 2], self.start.target[0])

    def place(self, places: np.ndarray) -> bool:
        """Begins an episode with ball and target elsewhere, the robot as it was; returns whether the ball has room.

        Args:
            places: Ball and target as in `places` [4], m.
        """
        moved = torch.as_tensor(places, dtype=torch.float64)
        if not moved.isfinite().all() or self.env.sampler.overlaps(moved[:1], moved[1:2]).any():
            return False
        qpos = self.start.qpos.clone()
        qpos[0, self._ball : self._ball + 2] = moved[:2]
        self.start = replace(self.start, qpos=qpos, target=moved[2:].unsqueeze(0))
        self.restart()
        return True

    def elapse(self, seconds: float) -> None:
        """Lets so much real time pass, s."""
        if self.paused:
            return
        self._credit = min(self._credit + seconds * self.speed, max(_LAG, self._dt))
        while self._credit >= self._dt:
            self._credit -= self._dt
            self.step()

    @torch.inference_mode()
    def step(self) -> None:
        """Advances the episode by one control step; once it has ended, waits and begins the next."""
        if self.ending:
            self._hold -= 1
            if self._hold <= 0:
                self.restart() if self.repeat else self.show(self.number + 1)
            return
        env = self.env
        idle = torch.zeros(1, env.num_actions)
        state = env.advance(idle if self._policy is None else self._policy(env.get_observations()))
        if not env.engine.failed[0]:
            self.qpos = env.engine.qpos[0].numpy().copy()
        env.finish(state)
        assert env.outcome is not None
        self.outcome = env.outcome
        total = self.outcome.rewards[0].numpy()
        self.rewards = np.stack([total - self.rewards[1], total])
        if self.outcome.done[0]:
            self._conclude(self.outcome)

    def _conclude(self, outcome: Outcome) -> None:
        names = [bound.name for bound in self.env.task.terminations]
        self.ending = NON_FINITE if outcome.failed[0] else names[int(outcome.terminated[0].int().argmax())]
        self._hold = round(_HOLD / self._dt)
        tally = self.tallies[self.mirrored]
        tally.episodes, tally.successes = tally.episodes + 1, tally.successes + int(outcome.success[0])

    def lines(self) -> list[str]:
        """What is to be said of the episode."""
        out, side = self.outcome, "mirror image of " if self.mirrored else ""
        steps, foot = (int(out.steps[0]), FOOT_NAMES[int(out.record.kick_foot[0])]) if out else (0, "none")
        x, y, target_x, target_y = self.places
        distance = float(out.distance[0]) if out else float(np.hypot(target_x - x, target_y - y))
        success = " (success)" if out and out.success[0] else ""
        return [
            f"{side}initial state {self.number}, {steps * self._dt:.2f} s",
            f"foot that touched the ball first: {foot}",
            f"ball to target: {distance:.2f} m",
            f"ended: {self.ending}{success}" if self.ending else "paused" if self.paused else "running",
            f"success: {self.tallies[0]}, mirrored {self.tallies[1]} episodes",
        ]

    def close(self) -> None:
        """Frees the engine."""
        self.env.engine.close()


def slider_limits(task: CompiledTask) -> np.ndarray:
    """Lowest and highest ball x, y, target x, y on the sliders [4, 2], m: the regions, their images and a margin."""
    regions = outlines(task.spec.sampling)
    corners = [np.concatenate([region, region * [1.0, -1.0]]) for region in (regions.ball, regions.target)]
    limits = np.concatenate([np.stack([c.min(axis=0), c.max(axis=0)], axis=1) for c in corners])
    margin = np.maximum(0.25 * np.ptp(limits, axis=1), 0.1)
    return limits + margin[:, None] * [-1.0, 1.0]


class Player:
    """A session in a viewer (`studio.Panel`): the scene, and a window with buttons, keys, sliders and figures."""

    def __init__(self, session: Session, title: str) -> None:
        """Takes the session and the title of its window."""
        self._session, self._title, self._blocked = session, title, False
        self._limits = slider_limits(session.env.task)
        self._before: float | None = None

    def prepare(self, viewer: Any) -> None:
        """Puts the camera behind the robot, where it sees the targets, and the robot beside the window."""
        reach, camera = float(self._limits[2, 1]), viewer.camera
        camera.lookat[:] = [0.3 * reach, 0.25 * reach, 0.2]
        camera.distance, camera.azimuth, camera.elevation = 1.5 + 0.8 * reach, 20.0, -22.0

    def update(self, viewer: Any) -> None:
        """Lets the time since the last frame pass, and places robot, ball and target."""
        now = time.monotonic()
        self._session.elapse(0.0 if self._before is None else now - self._before)
        self._before = now
        viewer.data.qpos[:] = self._session.qpos
        viewer.data.mocap_pos[viewer.model.body("target").mocapid[0], :2] = self._session.start.target[0]
        mujoco.mj_forward(viewer.model, viewer.data)

    def draw(self, imgui: Any) -> None:
        """Builds the window with the bindings of Dear ImGui, and does what is asked for in it."""
        first = int(imgui.Cond.FirstUseEver)
        imgui.SetNextWindowPos(imgui.Vec2(12, 12), first)
        imgui.SetNextWindowSize(imgui.Vec2(430, 645), first)
        expanded, is_open = imgui.Begin(self._title, True)
        if not is_open:
            imgui.SetWindowCollapsed(expanded)
        self._buttons(imgui)
        self._sliders(imgui)
        for line in self._session.lines():
            imgui.TextUnformatted(line)
        self._table(imgui)
        imgui.End()

    def _buttons(self, imgui: Any) -> None:
        session = self._session

        def pause() -> None:
            session.paused = not session.paused

        actions = (
            ("go on (space)" if session.paused else "pause (space)", imgui.Key.Space, pause),
            ("step (S)", imgui.Key.S, session.step),
            ("reset (R)", imgui.Key.R, session.restart),
            ("next (N)", imgui.Key.N, lambda: session.show(session.number + 1)),
            ("mirror (M)", imgui.Key.M, session.mirror),
        )
        typing = imgui.IsAnyItemActive()
        for place, (label, key, action) in enumerate(actions):
            if place:
                imgui.SameLine()
            if imgui.Button(label) or (not typing and imgui.IsKeyPressed(key, False)):
                action()

    def _sliders(self, imgui: Any) -> None:
        session = self._session
        _, session.repeat = imgui.Checkbox("repeat this initial state", session.repeat)
        _, session.speed = imgui.SliderFloat("speed", session.speed, 0.05, 2.0, "%.2f x")
        places, moved = session.places, False
        for place, name in enumerate(("ball x", "ball y", "target x", "target y")):
            changed, value = imgui.SliderFloat(name, places[place], *self._limits[place], "%.2f m")
            if changed:
                places[place], moved = value, True
        if moved:
            self._blocked = not session.place(places)
        if self._blocked:
            imgui.TextUnformatted("no room for the ball there: the robot is in the way")

    def _table(self, imgui: Any) -> None:
        if not imgui.BeginTable("rewards", 3):
            return
        for heading in ("reward term", "this step", "episode"):
            imgui.TableSetupColumn(heading)
        imgui.TableHeadersRow()
        names = [bound.name for bound, _ in self._session.env.task.rewards]
        last, total = self._session.rewards
        rows = [*zip(names, last, total, strict=True), ("sum", last.sum(), total.sum())]
        for name, now, so_far in rows:
            for text in (name, f"{now:+.4f}", f"{so_far:+.3f}"):
                imgui.TableNextColumn()
                imgui.TextUnformatted(text)
        imgui.EndTable()


def play(
    task: CompiledTask,
    policy: Policy | None,
    title: str,
    *,
    seed: int,
    host: str,
    port: int,
    browser: bool | None,
) -> None:
    """Shows a policy on a task in a browser until Ctrl-C.

    Args:
        task: Compiled task.
        policy: Deterministic policy; None: zero action.
        title: Title of page and window.
        seed: Seed of the initial states.
        host: Interface to bind.
        port: Port; if it is taken, one of the next.
        browser: Whether to open a browser; None: where there is one.

    Raises:
        KickbenchError: MuJoCo has no viewer that can be guarded, or `studio.show` fails.
    """
    try:
        from kickbench.view.studio import show
    except (ImportError, AttributeError) as error:
        raise KickbenchError(
            f"MuJoCo {mujoco.__version__} lacks the tested web viewer ({error}): pip install 'mujoco==4.0.*'"
        ) from None
    session = Session(task, policy, seed)
    try:
        with torch_threads(1):
            show(dress(task.scene.spec, 640, 480), Player(session, title), title, host, port, browser)
    finally:
        session.close()
