"""A copy of a model with equal sides, on which an unequal robot does not blur the proof of a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from itertools import permutations, product
from typing import NamedTuple

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.sim.read_parts import PartsReader
from kickbench.symmetry.derive import Derivation, Match
from kickbench.symmetry.model_parts import PLANES, Law, mirror_value

_PLANE, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
)
_FREE, _SLIDE, _HINGE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("FREE", "SLIDE", "HINGE")
)
_FLIPS = np.array(
    [
        np.eye(3)[list(order)] * signs
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
        if np.linalg.det(np.eye(3)[list(order)] * signs) < 0.0
    ]
)
"""The signed permutations of three axes that turn a right-handed frame into a left-handed one [24, 3, 3]."""
_SAME_FRAME = 0.3
"""Largest distance (Frobenius) between a body's frame and the mirror image of its partner's that is an error,
no convention."""
_FIELDS: dict[str, dict[Law, str]] = {
    "body": {"scalar": "body_mass body_gravcomp"},
    "joint": {
        "scalar": "jnt_stiffness jnt_solref jnt_solimp jnt_margin jnt_limited jnt_actfrclimited",
        "range": "jnt_range jnt_actfrcrange",
    },
    "dof": {"scalar": "dof_damping dof_armature dof_frictionloss dof_solref dof_solimp"},
    "position": {"signed": "qpos0 qpos_spring"},
    "geom": {
        "scalar": "geom_friction geom_solref geom_solimp geom_solmix geom_margin geom_gap geom_condim "
        "geom_priority geom_contype geom_conaffinity"
    },
    "actuator": {
        "scalar": "actuator_gainprm actuator_dynprm actuator_damping actuator_forcelimited "
        "actuator_ctrllimited",
        "range": "actuator_forcerange actuator_ctrlrange",
    },
}
"""What a part takes over from its mirror image, by law, as arrays of the model."""


class Pair(NamedTuple):
    """A part's index, its mirror image's (an earlier one, or its own), and the coordinate's sign."""

    part: int
    image: int
    sign: int


def symmetrised(model: mujoco.MjModel, derivation: Derivation, prefix: str = "") -> mujoco.MjModel:
    """A copy in which the later part of every pair is the mirror image of the earlier one.

    Central parts are projected on the mirror plane. Meshes that touch become boxes of their extent; shapes
    without a mirror image touch nothing, and bodies without one and without a joint weigh nothing.

    Args:
        model: Compiled model.
        derivation: What its geometry says.
        prefix: Prefix of the robot's names in it, as in `read_parts`.
    """
    return _Symmetriser(model, derivation, prefix).run()


def pairs_of(matches: Sequence[Match]) -> list[Pair]:
    """The pairs among some matches, by their places; those without a partner are left out."""
    places = {match.name: place for place, match in enumerate(matches)}
    found = [Pair(i, places[m.partner], m.sign or 1) for i, m in enumerate(matches) if m.partner is not None]
    return [pair for pair in found if pair.image <= pair.part]


def copy_images(array: np.ndarray, pairs: Sequence[Pair], law: Law) -> None:
    """Gives parts the values of their mirror images, in place; central parts the mean of both."""
    for part, image, sign in pairs:
        value = mirror_value(array[image], law, np.eye(3), sign)
        array[part] = value if part != image or law == "scalar" else (array[part] + value) / 2


class _Symmetriser:
    def __init__(self, model: mujoco.MjModel, derivation: Derivation, prefix: str) -> None:
        reader = PartsReader(model, prefix)
        self.model, self.data, self.derivation = copy(model), reader.data, derivation
        ids = {
            "body": np.array(reader.bodies, dtype=np.int64),
            "joint": np.array(reader.joints, dtype=np.int64),
            "geom": np.array(reader.geoms, dtype=np.int64),
            "site": np.array(reader.sites, dtype=np.int64),
            "actuator": np.arange(model.nu),
        }
        self.ids = ids
        matches = {
            "body": derivation.bodies,
            "joint": derivation.joints,
            "geom": derivation.shapes,
            "site": derivation.sites,
            "actuator": derivation.actuators,
        }
        self.pairs = {
            kind: [Pair(int(ids[kind][p]), int(ids[kind][i]), sign) for p, i, sign in pairs_of(found)]
            for kind, found in matches.items()
        }
        self.alone = {
            kind: [int(ids[kind][i]) for i, match in enumerate(found) if match.partner is None]
            for kind, found in matches.items()
        }
        self.origin, turn = reader.origin, reader.rotation
        self.mirror = turn @ PLANES[derivation.plane] @ turn.T
        """The reflection, on vectors in the world's frame [3, 3]."""

    def run(self) -> mujoco.MjModel:
        model = self.model
        self._box_meshes()
        self._drop_odd_parts()
        self._move_frames()
        self._copy_fields()
        for kind in ("body", "geom", "site"):
            getattr(model, f"{kind}_sameframe")[self.ids[kind]] = 0
        model.opt.disableflags |= (
            mujoco.mjtDisableBit.mjDSBL_MIDPHASE
        )  # its boxes are those of the old shapes
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _box_meshes(self) -> None:
        """Hulls of two meshes are no mirror images."""
        model, data = self.model, self.data
        for geom in self.ids["geom"]:
            if model.geom_type[geom] == _MESH:
                centre, half = np.split(model.geom_aabb[geom], 2)
                model.geom_type[geom], model.geom_dataid[geom] = _BOX, -1
                model.geom_size[geom] = half
                data.geom_xpos[geom] += data.geom_xmat[geom].reshape(3, 3) @ centre

    def _drop_odd_parts(self) -> None:
        model = self.model
        for geom in self.alone["geom"]:
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
        for body in self.alone["body"]:
            if not model.body_jntnum[body]:
                model.body_mass[body], model.body_inertia[body] = 0.0, 0.0

    # Places and directions: mirrored in the world's frame, then written in the frame of the body

    def _move_frames(self) -> None:
        model, data = self.model, self.data
        self._mirror_frames("body", data.xpos, data.xmat, None)
        self._mirror_frames("body", data.xipos, data.ximat, model.body_inertia)
        self._mirror_frames("site", data.site_xpos, data.site_xmat, None)
        sizes = np.array([self._sizes(g) for g in range(model.ngeom)]).reshape(-1, 3)
        self._mirror_frames("geom", data.geom_xpos, data.geom_xmat, sizes)
        for geom in self.ids["geom"]:
            self._set_size(geom, sizes[geom])
        self._mirror_joints()
        for body in self.ids["body"]:
            parent = model.body_parentid[body]
            self._write(body, parent, data.xpos, data.xmat, model.body_pos, model.body_quat)
            self._write(body, body, data.xipos, data.ximat, model.body_ipos, model.body_iquat)
        for kind in ("geom", "site"):
            for part in self.ids[kind]:
                places, turns = getattr(data, f"{kind}_xpos"), getattr(data, f"{kind}_xmat")
                owner = getattr(model, f"{kind}_bodyid")[part]
                self._write(
                    part, owner, places, turns, getattr(model, f"{kind}_pos"), getattr(model, f"{kind}_quat")
                )

    def _mirror_frames(
        self, kind: str, places: np.ndarray, turns: np.ndarray, sizes: np.ndarray | None
    ) -> None:
        """Mirrors places [N, 3] and frames [N, 9] with the sizes along their axes [N, 3], if any."""
        for part, image, _ in self.pairs[kind]:
            own, frame = turns[part].reshape(3, 3), turns[image].reshape(3, 3)
            flips = [f for f in _FLIPS if part != image or (f == f.T).all()]
            options = np.array([self.mirror @ frame @ flip for flip in flips])
            cost = np.linalg.norm(options - own, axis=(1, 2))
            if sizes is not None:
                there = np.array([np.abs(flip).T @ sizes[image] for flip in flips])
                cost += 10.0 * np.abs(there - sizes[part]).max(axis=1) / max(sizes[part].max(), 1e-12)
                best = int(cost.argmin())
                sizes[part] = there[best] if part != image else (sizes[part] + there[best]) / 2
            best = int(cost.argmin())
            mirrored = self._mirrored(places[image])
            places[part] = mirrored if part != image else (places[part] + mirrored) / 2
            if sizes is not None or cost[best] < _SAME_FRAME:
                turns[part] = (options[best] if part != image else _rotation(own + options[best])).ravel()

    def _mirrored(self, point: np.ndarray) -> np.ndarray:
        return self.origin + self.mirror @ (point - self.origin)

    def _sizes(self, geom: int) -> np.ndarray:
        a, b, c = self.model.geom_size[geom]
        kind = self.model.geom_type[geom]
        if kind == _SPHERE:
            return np.array([a, a, a])
        return np.array([a, a, b] if kind in (_CAPSULE, _CYLINDER) else [a, b, c])

    def _set_size(self, geom: int, sizes: np.ndarray) -> None:
        model, kind = self.model, self.model.geom_type[geom]
        if kind in (_CAPSULE, _CYLINDER):
            model.geom_size[geom, :2] = sizes[[0, 2]]
        elif kind in (_SPHERE, _BOX, _ELLIPSOID):
            model.geom_size[geom] = sizes
        if kind != _PLANE:
            model.geom_rbound[geom] = max(model.geom_rbound[geom], float(np.linalg.norm(sizes)))

    def _mirror_joints(self) -> None:
        model, data = self.model, self.data
        for part, image, sign in self.pairs["joint"]:
            if model.jnt_type[part] in (_SLIDE, _HINGE):
                law = "axial" if model.jnt_type[part] == _HINGE else "polar"
                axis = sign * mirror_value(data.xaxis[image], law, self.mirror)
                anchor = self._mirrored(data.xanchor[image])
                if part == image:
                    axis, anchor = data.xaxis[part] + axis, (data.xanchor[part] + anchor) / 2
                data.xaxis[part], data.xanchor[part] = axis / np.linalg.norm(axis), anchor
        for joint in self.ids["joint"]:
            body = model.jnt_bodyid[joint]
            turn = data.xmat[body].reshape(3, 3).T
            model.jnt_axis[joint] = turn @ data.xaxis[joint]
            if model.jnt_type[joint] != _FREE:
                model.jnt_pos[joint] = turn @ (data.xanchor[joint] - data.xpos[body])

    def _write(
        self,
        part: int,
        owner: int,
        places: np.ndarray,
        turns: np.ndarray,
        pos: np.ndarray,
        quat: np.ndarray,
    ) -> None:
        """Writes a place and a frame of the world in the frame of a body."""
        turn = self.data.xmat[owner].reshape(3, 3).T
        pos[part] = turn @ (places[part] - self.data.xpos[owner])
        mujoco.mju_mat2Quat(quat[part], (turn @ turns[part].reshape(3, 3)).ravel())

    def _copy_fields(self) -> None:
        model, joints = self.model, list(self._hinges())
        pairs = {
            **self.pairs,
            "joint": joints,
            "dof": [Pair(model.jnt_dofadr[p], model.jnt_dofadr[i], s) for p, i, s in joints],
            "position": [Pair(model.jnt_qposadr[p], model.jnt_qposadr[i], s) for p, i, s in joints],
        }
        for kind, laws in _FIELDS.items():
            for law, names in laws.items():
                for name in names.split():
                    copy_images(getattr(model, name), pairs[kind], law)
        copy_images(model.actuator_biasprm[:, 1:], pairs["actuator"], "scalar")
        copy_images(model.actuator_biasprm[:, 0], pairs["actuator"], "signed")

    def _hinges(self) -> Iterator[Pair]:
        """Pairs of joints with one coordinate whose sign is known."""
        known = self.derivation.image
        for pair in self.pairs["joint"]:
            if self.derivation.joints[int(np.searchsorted(self.ids["joint"], pair.part))].name in known:
                yield pair


def _rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix [3, 3]."""
    left, _, right = np.linalg.svd(matrix)
    return left @ right
