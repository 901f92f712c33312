"""A task's scene as pictures show it: its look (for pictures only), the camera, and a state as pixels."""

from __future__ import annotations

from collections.abc import Sequence

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.envs.compiled_task import CompiledTask
from kickbench.view.backend import make_context

_FIELD_OF_VIEW = 40.0
"""Vertical field of view, degrees."""
_ELEVATION, _ASIDE = -18.0, 25.0
"""Angle by which the camera looks down, and its angle to the line from robot to target, degrees."""
_SHADOW_REACH = 2.5
"""Shadows fall within this distance of the robot's start, m: the map of a wider area would be coarse."""
_POLE, _RED = 0.5, [0.95, 0.25, 0.2, 1.0]
"""Height of the pole in a target, m, and its colour."""


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
        self._ball = task.scene.layout.ball_qpos
        self.model = dress(task.scene.spec, width, height)
        self._data = mujoco.MjData(self.model)
        self._scene = mujoco.MjvScene(self.model, 2000)
        self._gl = make_context(width, height)
        self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *error: object) -> None:
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def camera(self, qpos: np.ndarray, target: np.ndarray) -> mujoco.MjvCamera:
        """The camera of an episode: it looks past the robot to the target, from the ball's side.

        Args:
            qpos: Generalised positions in the initial state [nq].
            target: Target on the floor [2], m.
        """
        ball = qpos[self._ball : self._ball + 2]
        side = target[0] * ball[1] - target[1] * ball[0]  # positive: the ball is to the left of the line
        heading = np.degrees(np.arctan2(target[1], target[0])) - np.copysign(_ASIDE, side)
        return look_at([*0.4 * target, 0.3], 2.0 + 0.65 * float(np.linalg.norm(target)), heading)

    def portrait(self, half: float, height: float) -> mujoco.MjvCamera:
        """A camera that has a box around the origin in the picture, seen from ahead and the left.

        Args:
            half: Half of the box's side, m.
            height: Its height, m.
        """
        radius = np.hypot(np.hypot(half, half), height / 2)
        distance = radius / np.sin(np.radians(_FIELD_OF_VIEW / 2))
        return look_at([0.0, 0.0, height / 2], distance, 180.0 + 2 * _ASIDE)

    def picture(self, qpos: np.ndarray, target: np.ndarray, camera: mujoco.MjvCamera) -> np.ndarray:
        """Renders a state.

        Args:
            qpos: Generalised positions [nq].
            target: Target on the floor [2], m.
            camera: The camera.

        Returns:
            Pixels [height, width, 3], uint8, the upper row first.
        """
        self._data.qpos[:] = qpos
        self._data.mocap_pos[self.model.body("target").mocapid[0], :2] = target
        for place in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
            place(self.model, self._data)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self.model, self._data, mujoco.MjvOption(), None, camera, everything, self._scene
        )
        self._scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = True
        self._gl.make_current()
        area = mujoco.MjrRect(0, 0, self.width, self.height)
        pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        mujoco.mjr_render(area, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, None, area, self._context)
        return pixels[::-1]


def look_at(point: Sequence[float], distance: float, azimuth: float) -> mujoco.MjvCamera:
    """A camera that looks down at a point.

    Args:
        point: The point [3], m.
        distance: From the camera, m.
        azimuth: Heading of the view, degrees from the x axis, counter-clockwise.
    """
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = point, distance, azimuth, _ELEVATION
    return camera


def dress(scene: mujoco.MjSpec, width: int, height: int) -> mujoco.MjModel:
    """Compiles a copy of the scene with the look of pictures; coordinates and bodies are those of the scene.

    Args:
        scene: The scene, left as it is.
        width: Width of the largest picture, pixels.
        height: Its height, pixels.
    """
    scene = scene.copy()
    visual = scene.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = _FIELD_OF_VIEW
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 4
    visual.headlight.ambient = [0.28] * 3
    visual.rgba.haze = [0.80, 0.88, 0.94, 1.0]
    scene.stat.extent, scene.stat.center = _SHADOW_REACH, [0.0, 0.0, 0.3]
    # Planes near and far, and the haze, are in units of the extent.
    visual.map.znear, visual.map.zfar, visual.map.shadowclip, visual.map.shadowscale = 0.01, 40.0, 1.0, 0.9
    _paint(scene)
    if scene.body("goal") is None:
        pole = scene.body("target").add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, mass=0.0, rgba=_RED)
        pole.size, pole.pos = [0.02, _POLE / 2, 0.0], [0.0, 0.0, _POLE / 2]
        pole.contype = pole.conaffinity = 0
    return scene.compile()


def _paint(scene: mujoco.MjSpec) -> None:
    """Sky, grass, and a ball whose roll is seen."""
    textures, builtin = mujoco.mjtTexture, mujoco.mjtBuiltin
    sky = scene.add_texture(name="kickbench_sky", type=textures.mjTEXTURE_SKYBOX, width=256, height=1536)
    sky.builtin, sky.rgb1, sky.rgb2 = builtin.mjBUILTIN_GRADIENT, [0.36, 0.58, 0.82], [0.86, 0.92, 0.96]
    grass = scene.texture("grid")
    grass.rgb1, grass.rgb2 = [0.30, 0.55, 0.31], [0.335, 0.60, 0.345]
    patches = scene.add_texture(name="kickbench_ball", type=textures.mjTEXTURE_CUBE, width=64, height=64)
    patches.builtin, patches.rgb1, patches.rgb2 = builtin.mjBUILTIN_CHECKER, [0.98] * 3, [0.16, 0.30, 0.62]
    material = scene.add_material(name="kickbench_ball")
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "kickbench_ball"
    floor, ball, target = (scene.geom(name) for name in ("floor", "ball", "target"))
    ball.material, ball.rgba, target.rgba = "kickbench_ball", [1.0] * 4, [0.98, 0.82, 0.12, 0.55]
    # Flat things only cast shadows on themselves: specks, where the resolution of the map's depth is too low.
    floor.castshadow = target.castshadow = False
