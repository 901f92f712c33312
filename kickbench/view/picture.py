"""Renders one moment of a task to an array of pixels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from types import TracebackType

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.envs.compile import CompiledTask
from kickbench.sim.sensors import ROBOT
from kickbench.view.backend import make_context
from kickbench.view.camera import Camera, choose_camera
from kickbench.view.look import dress, flag_points

_CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(8, 3)
_SPOTS = np.array([[0, 0, 0], [0.8, 0, 0], [-0.8, 0, 0], [0, 0.8, 0], [0, -0.8, 0], [0, 0, 0.8]])
"""Points of the ball that are looked for, in radii."""
_LOOKS = 8
"""Moments at most at which a camera is asked whether it sees the ball."""
_MAX_GEOMS = 2000


@dataclass(frozen=True)
class Shot:
    """What pictures of one episode share.

    Attributes:
        target: Target on the floor [2], m.
        camera: The camera.
        subjects: Places in the picture that robot, ball and target take [N, 2], from -1 to 1, left to right and
            bottom to top.
    """

    target: np.ndarray
    camera: Camera
    subjects: np.ndarray


class Stage:
    """A task's scene, dressed for pictures of one size. To be used in a `with`."""

    def __init__(self, task: CompiledTask, width: int, height: int) -> None:
        """Compiles the dressed scene and opens an OpenGL context.

        Args:
            task: The task.
            width: Width of the pictures, pixels.
            height: Their height, pixels.

        Raises:
            KickbenchError: There is no OpenGL.
        """
        self.width, self.height = width, height
        self._layout, self._radius = task.scene.layout, task.spec.ball.radius
        self._ring = task.spec.evaluation.success_radius
        self.model = dress(task.scene.spec, width, height)
        self._data = mujoco.MjData(self.model)
        self._flag = int(self.model.body("target").mocapid[0])
        names = [self.model.geom(g).name for g in range(self.model.ngeom)]
        bodies = [self.model.body(int(body)).name for body in self.model.geom_bodyid]
        shown = self.model.geom_group < 3
        self._robot = np.flatnonzero([name.startswith(ROBOT) for name in bodies] & shown)
        self._ball_geom = names.index("ball")
        self._scene = mujoco.MjvScene(self.model, _MAX_GEOMS)
        self._gl = make_context(width, height)
        self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def shot(self, moments: Iterable[np.ndarray], target: np.ndarray) -> Shot:
        """Sets up one picture, or all pictures of an episode.

        Args:
            moments: Generalised positions [nq] at which robot and ball must be seen.
            target: Target on the floor [2], m.
        """
        moments = list(moments)
        subjects = [self._target_points(target)]
        for qpos in moments:
            self._place(qpos, target)
            subjects += [self._robot_points(), self._ball_points()]
        self._place(moments[0], target)
        robot, points = self._robot_points(), np.concatenate(subjects)
        aspect = self.width / self.height
        middle = (robot.min(axis=0) + robot.max(axis=0)) / 2.0

        def visibility(eye: np.ndarray) -> float:
            few = moments[:: len(moments) // _LOOKS + 1]
            return sum(self._ball_visibility(qpos, target, eye) for qpos in few) / len(few)

        camera = choose_camera(points, middle, target, aspect, visibility)
        return Shot(target, camera, camera.project(points, aspect))

    def picture(self, qpos: np.ndarray, shot: Shot) -> np.ndarray:
        """Renders a moment.

        Args:
            qpos: Generalised positions [nq].
            shot: Target and camera.

        Returns:
            Pixels [height, width, 3], uint8, the upper row first.
        """
        self._place(qpos, shot.target)
        view, camera = mujoco.MjvCamera(), shot.camera
        view.azimuth, view.elevation, view.distance = camera.azimuth, camera.elevation, 1.0
        view.lookat[:] = camera.position + camera.axes[2]
        mujoco.mjv_updateScene(
            self.model, self._data, mujoco.MjvOption(), None, view, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        self._scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = True
        self._gl.make_current()
        area = mujoco.MjrRect(0, 0, self.width, self.height)
        pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        mujoco.mjr_render(area, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, None, area, self._context)
        return pixels[::-1]

    def _place(self, qpos: np.ndarray, target: np.ndarray) -> None:
        self._data.qpos[:] = qpos
        self._data.mocap_pos[self._flag, :2] = target
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)
        mujoco.mj_camlight(self.model, self._data)

    def _robot_points(self) -> np.ndarray:
        """Corners of the boxes around the robot's geoms [8 K, 3]."""
        rotation = self._data.geom_xmat[self._robot].reshape(-1, 1, 3, 3)
        box = self.model.geom_aabb[self._robot]
        corners = box[:, None, :3] + _CORNERS * box[:, None, 3:]
        placed = self._data.geom_xpos[self._robot][:, None] + (rotation @ corners[..., None])[..., 0]
        return placed.reshape(-1, 3)

    def _ball_points(self) -> np.ndarray:
        return self._data.geom_xpos[self._ball_geom] + self._radius * _CORNERS

    def _target_points(self, target: np.ndarray) -> np.ndarray:
        angles = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
        ring = self._ring * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
        return np.append(target, 0.0) + np.concatenate([ring, flag_points(self._ring)])

    def _ball_visibility(self, qpos: np.ndarray, target: np.ndarray, eye: np.ndarray) -> float:
        """Share of the ball's points that a ray from the eye meets before anything else."""
        self._place(qpos, target)
        hit, seen = np.zeros(1, dtype=np.int32), 0
        groups = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)
        centre = self._data.geom_xpos[self._ball_geom]
        for spot in centre + self._radius * _SPOTS:
            mujoco.mj_ray(self.model, self._data, eye, spot - eye, groups, 1, -1, hit)
            seen += int(hit[0] == self._ball_geom)
        return seen / len(_SPOTS)
