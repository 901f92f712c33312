"""A task's scene as pictures show it: its look (for pictures only), the camera, and a state as pixels."""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.envs.compiled_task import CompiledTask
from kickbench.view.backend import make_context

_FIELD_OF_VIEW = 40.0
"""Vertical field of view, degrees."""
_ELEVATION, _ASIDE = -18.0, 25.0
"""Angle by which the camera looks down, and its angle to the line from robot to target, degrees."""
_MARGIN = 0.07
"""Share of a picture that stays free on every side."""
_SHADOW_REACH = 2.5
"""Shadows fall within this distance of the robot's start, m: the map of a wider area would be coarse."""
_ROBOT = (0.25, 1.1)
"""Half of the side, and height of the box around a robot at the origin, m."""


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
        self._ball, self._radius = task.scene.layout.ball_qpos, task.spec.evaluation.success_radius
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
        flag = _box(target, self._radius, _flag_height(self._radius))
        points = np.concatenate([_box((0.0, 0.0), *_ROBOT), _box(ball, 0.2, 0.2), flag])
        return fit_camera(points, heading, _ELEVATION, self.width / self.height)

    def portrait(self, half: float, height: float) -> mujoco.MjvCamera:
        """A camera that has a box around the origin in the picture, seen from ahead and the left.

        Args:
            half: Half of the box's side, m.
            height: Its height, m.
        """
        return fit_camera(
            _box((0.0, 0.0), half, height), 180.0 + 2 * _ASIDE, _ELEVATION, self.width / self.height
        )

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


def fit_camera(points: np.ndarray, azimuth: float, elevation: float, aspect: float) -> mujoco.MjvCamera:
    """The nearest camera of a given direction that has all points in the picture, well centred.

    A point at (r, u, d) in the camera's axes is inside if |r - r0| <= s (d - d0): of all points the largest
    of r - s d and of -r - s d decide, so the least retreat is half their sum. The same holds for u; the
    direction that needs more retreat is filled, the other has its points centred.

    Args:
        points: What must be seen [N, 3], m.
        azimuth: Heading of the view, degrees from the x axis, counter-clockwise.
        elevation: Slope of the view, degrees; negative looks down.
        aspect: Width of the picture over its height.
    """
    a, e = np.radians(azimuth), np.radians(elevation)
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    axes = np.stack([right, np.cross(right, forward), forward])
    *plane, depth = axes @ points.T
    slopes = np.tan(np.radians(_FIELD_OF_VIEW) / 2.0) * np.array([aspect, 1.0]) * (1.0 - 2.0 * _MARGIN)
    high = [np.max(p - s * depth) for p, s in zip(plane, slopes, strict=True)]
    low = [np.max(-p - s * depth) for p, s in zip(plane, slopes, strict=True)]
    nearest = min(-(h + w) / (2.0 * s) for h, w, s in zip(high, low, slopes, strict=True))
    position = np.array([*((h - w) / 2.0 for h, w in zip(high, low, strict=True)), nearest]) @ axes
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, 1.0
    camera.lookat[:] = position + forward
    return camera


def _box(centre: np.ndarray | tuple[float, float], half: float, height: float) -> np.ndarray:
    """Corners [8, 3] of an upright box on the floor."""
    corners = np.stack(np.meshgrid((-half, half), (-half, half), (0.0, height)), axis=-1).reshape(8, 3)
    return corners + np.array([*centre, 0.0])


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
        _add_flag(scene)
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


def _add_flag(scene: mujoco.MjSpec) -> None:
    """A pole in the target, with a cloth to be seen from every side."""
    height = _flag_height(scene.geom("target").size[0])
    cylinder, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    white, red = [0.9, 0.9, 0.9, 1.0], [0.95, 0.25, 0.2, 1.0]
    for kind, size, place, colour in (
        (cylinder, [0.012, height / 2, 0.0], [0.0, 0.0, height / 2], white),
        (box, [0.09, 0.004, 0.06], [0.1, 0.0, height - 0.06], red),
        (box, [0.004, 0.09, 0.06], [0.0, 0.1, height - 0.06], red),
    ):
        flag = scene.body("target").add_geom(type=kind, size=size, pos=place, rgba=colour, mass=0.0)
        flag.contype = flag.conaffinity = 0


def _flag_height(radius: float) -> float:
    """Height of the flag in a target of that radius, m."""
    return 0.3 + 0.5 * radius
