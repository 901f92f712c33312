"""The look of pictures: sky, light, a ball whose roll is seen, a flag in the target. Training never sees it."""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
import mujoco

from kickbench.view.camera import FIELD_OF_VIEW

_SHADOW_REACH = 2.5
"""Shadows fall within this distance of the robot's start, m: the map of a wider area would be coarse."""


def dress(scene: mujoco.MjSpec, width: int, height: int) -> mujoco.MjModel:
    """Compiles a copy of the scene with the look of pictures; coordinates and bodies are those of the scene.

    Args:
        scene: The scene, left as it is.
        width: Width of the largest picture, pixels.
        height: Its height, pixels.
    """
    scene = scene.copy()
    _set_visuals(scene, width, height)
    _add_sky(scene)
    _set_lights(scene)
    _paint(scene)
    _add_flag(scene)
    return scene.compile()


def _set_visuals(scene: mujoco.MjSpec, width: int, height: int) -> None:
    visual = scene.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = FIELD_OF_VIEW
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 4
    visual.rgba.haze = [0.80, 0.88, 0.94, 1.0]
    scene.stat.extent, scene.stat.center = _SHADOW_REACH, [0.0, 0.0, 0.3]
    # Planes near and far, and the haze, are in units of the extent.
    visual.map.znear, visual.map.zfar = 0.01, 40.0
    visual.map.shadowclip, visual.map.shadowscale = 1.0, 0.9


def _add_sky(scene: mujoco.MjSpec) -> None:
    sky = scene.add_texture(
        name="kickbench_sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
    )
    sky.width, sky.height = 256, 1536
    sky.rgb1, sky.rgb2 = [0.36, 0.58, 0.82], [0.86, 0.92, 0.96]


def _set_lights(scene: mujoco.MjSpec) -> None:
    for light in list(scene.lights):
        scene.delete(light)
    headlight = scene.visual.headlight
    headlight.ambient, headlight.diffuse, headlight.specular = [0.40] * 3, [0.22] * 3, [0.0] * 3
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    sun, fill = (
        scene.worldbody.add_light(type=directional, pos=[0.9, -0.6, 2.4], dir=[-0.4, 0.3, -1.0]),
        scene.worldbody.add_light(type=directional, pos=[-2.0, 2.0, 2.0], dir=[1.0, -1.0, -0.8]),
    )
    sun.castshadow, sun.diffuse, sun.specular = True, [0.58, 0.57, 0.53], [0.25] * 3
    fill.castshadow, fill.diffuse, fill.specular = False, [0.16, 0.17, 0.20], [0.05] * 3


def _paint(scene: mujoco.MjSpec) -> None:
    # Flat things shade nothing but themselves, in specks where the map's depth is too coarse.
    scene.geom("floor").castshadow = scene.geom("target").castshadow = False
    grass = scene.texture("grid")
    grass.rgb1, grass.rgb2 = [0.30, 0.55, 0.31], [0.335, 0.60, 0.345]
    patches = scene.add_texture(
        name="kickbench_ball",
        type=mujoco.mjtTexture.mjTEXTURE_CUBE,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
    )
    patches.width = patches.height = 64
    patches.rgb1, patches.rgb2 = [0.98, 0.98, 0.98], [0.16, 0.30, 0.62]
    material = scene.add_material(name="kickbench_ball", specular=0.3, shininess=0.6)
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "kickbench_ball"
    ball = scene.geom("ball")
    ball.material, ball.rgba = "kickbench_ball", [1.0, 1.0, 1.0, 1.0]
    scene.geom("target").rgba = [0.98, 0.82, 0.12, 0.55]


def _add_flag(scene: mujoco.MjSpec) -> None:
    height = flag_height(scene.geom("target").size[0])
    # It shines a little: a flag is small, and often seen from its shaded side.
    scene.add_material(name="kickbench_flag", emission=0.5, specular=0.0)
    cylinder, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    white, red = [0.9, 0.9, 0.9, 1.0], [0.85, 0.2, 0.15, 1.0]
    parts = (
        (cylinder, [0.012, height / 2, 0.0], [0.0, 0.0, height / 2], white),
        (box, [0.09, 0.004, 0.06], [0.1, 0.0, height - 0.06], red),
        (box, [0.004, 0.09, 0.06], [0.0, 0.1, height - 0.06], red),
    )
    for kind, size, place, colour in parts:
        scene.body("target").add_geom(
            type=kind, size=size, pos=place, rgba=colour, material="kickbench_flag",
            mass=0.0, contype=0, conaffinity=0,
        )  # fmt: skip


def flag_height(radius: float) -> float:
    """Height of the flag in a target of that radius, m."""
    return 0.3 + 0.5 * radius


def flag_points(radius: float) -> list[list[float]]:
    """What must be seen of the flag, relative to the target's centre, m."""
    height = flag_height(radius)
    return [[0.0, 0.0, height], [0.19, 0.0, height - 0.06], [0.0, 0.19, height - 0.06]]
