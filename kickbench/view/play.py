"""A policy, live in a browser: its session in real time, with controls."""

from __future__ import annotations

import time
from typing import Any

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.episode import FOOT_NAMES
from kickbench.errors import KickbenchError
from kickbench.nets.actor_critic import torch_threads
from kickbench.sim.silence import silent
from kickbench.view.session import Session
from kickbench.view.stage import dress

_HOLD = 1.0
"""How long the end of an episode is shown, s."""
_LAG = 0.25
"""Largest simulated time per frame, s: a slow machine shows slow motion."""


class Player:
    """A session in Studio's viewer: the scene, and a window with buttons, keys, sliders and figures.

    Attributes:
        session: The running episode.
        paused: Whether time stands still.
        speed: Simulated over real time.
        repeat: Whether an episode is followed by one from the same initial state instead of the next.
        tallies: Successes and ended episodes, from initial states as drawn and from their mirror images.
    """

    def __init__(self, session: Session) -> None:
        """Takes the session, whose title is that of the window."""
        self.session, self._blocked = session, False
        self.paused, self.repeat, self.speed, self.tallies = False, False, 1.0, ([0, 0], [0, 0])
        self._limits = slider_limits(session.env.task)
        self._before = time.monotonic()
        self._credit, self._hold = 0.0, 0

    def elapse(self, seconds: float) -> None:
        """Advances by an amount of real time, s."""
        if self.paused:
            return
        interval = self.session.interval
        self._credit = min(self._credit + seconds * self.speed, max(_LAG, interval))
        while self._credit >= interval:
            self._credit -= interval
            self.step()

    def step(self) -> None:
        """Advances the episode by one control step; once it has ended, waits and begins the next."""
        session = self.session
        if session.ending:
            self._hold -= 1
            if self._hold <= 0:
                session.restart() if self.repeat else session.show(session.number + 1)
            return
        session.step()
        self._hold = round(_HOLD / session.interval)
        if session.ending and session.outcome is not None:
            tally = self.tallies[session.mirrored]
            tally[:] = tally[0] + int(session.outcome.success[0]), tally[1] + 1

    def lines(self) -> list[str]:
        """Lines of text about the episode."""
        session, out = self.session, self.session.outcome
        steps, foot = (int(out.steps[0]), FOOT_NAMES[int(out.record.kick_foot[0])]) if out else (0, "none")
        distance = float(np.linalg.norm(session.ball - session.start.target[0].numpy()))
        success = " (success)" if out and out.success[0] else ""
        home, mirrored = (f"{successes} of {episodes}" for successes, episodes in self.tallies)
        return [
            f"{'mirror image of ' if session.mirrored else ''}initial state {session.number}, "
            f"{steps * session.interval:.2f} s",
            f"foot that touched the ball first: {foot}",
            f"ball to target: {distance:.2f} m",
            f"ended: {session.ending}{success}" if session.ending else "paused" if self.paused else "running",
            f"success: {home}, mirrored {mirrored} episodes",
        ]

    def prepare(self, viewer: Any) -> None:
        """Puts the camera behind the robot, where it sees the targets, and the robot beside the window."""
        reach, camera = float(self._limits[2, 1]), viewer.camera
        camera.lookat[:] = [0.3 * reach, 0.25 * reach, 0.2]
        camera.distance, camera.azimuth, camera.elevation = 1.5 + 0.8 * reach, 20.0, -22.0

    @silent()
    def update(self, viewer: Any) -> None:
        """Lets the time since the last frame pass, and places robot, ball and target."""
        now = time.monotonic()
        self.elapse(now - self._before)
        self._before = now
        viewer.data.qpos[:] = self.session.qpos
        viewer.data.mocap_pos[viewer.model.body("target").mocapid[0], :2] = self.session.start.target[0]
        mujoco.mj_forward(viewer.model, viewer.data)

    def draw(self, imgui: Any) -> None:
        """Builds the window with the bindings of Dear ImGui, and does what is asked for in it."""
        first = int(imgui.Cond.FirstUseEver)
        imgui.SetNextWindowPos(imgui.Vec2(12, 12), first)
        imgui.SetNextWindowSize(imgui.Vec2(430, 645), first)
        expanded, is_open = imgui.Begin(self.session.title, True)
        if not is_open:
            imgui.SetWindowCollapsed(expanded)
        self._buttons(imgui)
        self._sliders(imgui)
        for line in self.lines():
            imgui.TextUnformatted(line)
        self._table(imgui)
        imgui.End()

    def _pause(self) -> None:
        self.paused = not self.paused

    def _buttons(self, imgui: Any) -> None:
        session, typing = self.session, imgui.IsAnyItemActive()
        actions = (
            ("go on (space)" if self.paused else "pause (space)", imgui.Key.Space, self._pause),
            ("step (S)", imgui.Key.S, self.step),
            ("reset (R)", imgui.Key.R, session.restart),
            ("next (N)", imgui.Key.N, lambda: session.show(session.number + 1)),
            ("mirror (M)", imgui.Key.M, session.mirror),
        )
        for place, (label, key, action) in enumerate(actions):
            if place:
                imgui.SameLine()
            if imgui.Button(label) or (not typing and imgui.IsKeyPressed(key, False)):
                action()

    def _sliders(self, imgui: Any) -> None:
        _, self.repeat = imgui.Checkbox("repeat this initial state", self.repeat)
        _, self.speed = imgui.SliderFloat("speed", self.speed, 0.05, 2.0, "%.2f x")
        places, moved = self.session.places, False
        for place, name in enumerate(("ball x", "ball y", "target x", "target y")):
            changed, value = imgui.SliderFloat(name, places[place], *self._limits[place], "%.2f m")
            if changed:
                places[place], moved = value, True
        if moved:
            self._blocked = not self.session.place(places)
        if self._blocked:
            imgui.TextUnformatted("no room for the ball there: the robot is in the way")

    def _table(self, imgui: Any) -> None:
        if not imgui.BeginTable("rewards", 3):
            return
        names = [bound.name for bound in self.session.env.task.rewards]
        last, total = self.session.rewards
        rows = [*zip(names, last, total, strict=True), ("sum", last.sum(), total.sum())]
        texts = [(name, f"{now:+.4f}", f"{so_far:+.3f}") for name, now, so_far in rows]
        for text in sum(texts, ("reward term", "this step", "episode")):
            imgui.TableNextColumn()
            imgui.TextUnformatted(text)
        imgui.EndTable()


def slider_limits(task: CompiledTask) -> np.ndarray:
    """Lowest and highest ball x, y, target x, y on the sliders [4, 2], m.

    They cover the regions, their mirror images and a margin.
    """
    ball, target = task.spec.sampling.ball, task.spec.sampling.target
    reaches = [(x, max(map(abs, y))) for x, y in ((ball.x, ball.y), target.extent())]
    limits = np.array([bounds for x, reach in reaches for bounds in (x, (-reach, reach))])
    margin = np.maximum(0.25 * np.ptp(limits, axis=1), 0.1)
    return limits + margin[:, None] * [-1.0, 1.0]


def play(session: Session, host: str, port: int, browser: bool | None) -> None:
    """Shows a session in a browser until Ctrl-C.

    Args:
        session: A session, whose title is that of page and window.
        host: Interface to bind.
        port: Port; if it is taken, one of the next.
        browser: Whether to open a browser; None: if there is one.

    Raises:
        KickbenchError: MuJoCo has no viewer that can be guarded, or `studio.show` fails.
    """
    with torch_threads(1):
        try:
            from kickbench.view.studio import show
        except (ImportError, AttributeError) as error:
            what = f"MuJoCo {mujoco.__version__} lacks the tested web viewer ({error})"
            raise KickbenchError(f"{what}: pip install 'mujoco==4.0.*'") from None
        show(dress(session.env.task.scene.spec, 640, 480), Player(session), host, port, browser)
