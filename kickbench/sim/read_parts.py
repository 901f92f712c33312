"""Reads the parts of a compiled model in the frame of its first body, in the reference pose."""

from __future__ import annotations

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.symmetry.model_parts import Actuator, Body, Joint, JointKind, ModelParts, Shape, Site

_JOINT_KINDS: dict[int, JointKind] = {
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
}


def read_parts(model: mujoco.MjModel, prefix: str = "") -> ModelParts:
    """Reads a model's parts.

    The frame is that of the first body: its own axes if a free joint carries it, else the world's axes
    through its origin. Parts that belong to no body (a floor) are left out.

    Args:
        model: Compiled model.
        prefix: Only bodies whose names begin so are read, and names lose it: the robot's part of a scene.
    """
    return _Reader(model, prefix).read()


class _Reader:
    """Where a model's parts are in the reference pose, and the frame that they are given in."""

    def __init__(self, model: mujoco.MjModel, prefix: str) -> None:
        self.model, self.prefix, self.data = model, prefix, mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)
        self.bodies = [b for b in range(1, model.nbody) if model.body(b).name.startswith(prefix)]
        self.index = {b: i for i, b in enumerate(self.bodies)}
        self.joints, self.geoms, self.sites = (
            np.flatnonzero(np.isin(owners, self.bodies)).tolist()
            for owners in (model.jnt_bodyid, model.geom_bodyid, model.site_bodyid)
        )
        self.origin, self.rotation = np.zeros(3), np.eye(3)
        if self.bodies:
            root = self.bodies[0]
            self.origin = self.data.xpos[root].copy()
            joint = model.body_jntadr[root]
            if joint >= 0 and _JOINT_KINDS[model.jnt_type[joint]] == "free":
                self.rotation = self.data.xmat[root].reshape(3, 3).copy()

    def read(self) -> ModelParts:
        """The parts."""
        return ModelParts(
            size=self._size(),
            bodies=tuple(map(self._body, self.bodies)),
            joints=tuple(map(self._joint, self.joints)),
            shapes=tuple(map(self._shape, self.geoms)),
            sites=tuple(map(self._site, self.sites)),
            actuators=tuple(map(self._actuator, range(self.model.nu))),
            left_out=tuple(self._left_out()),
        )

    def _size(self) -> float:
        data = self.data
        places = [data.xpos[self.bodies], data.xipos[self.bodies], data.geom_xpos[self.geoms]]
        return float(np.linalg.norm(np.concatenate(places) - self.origin, axis=1).max(initial=0.0)) or 1.0

    # Names, and what is given in the world's frame in the frame of the first body

    def _name(self, kind: str, index: int) -> str:
        name = getattr(self.model, kind)(index).name
        return name.removeprefix(self.prefix) or f"{kind} {index}"

    def _place(self, point: np.ndarray) -> np.ndarray:
        return self.rotation.T @ (point - self.origin)

    def _frame(self, matrix: np.ndarray) -> np.ndarray:
        return self.rotation.T @ matrix.reshape(3, 3)

    def _spread(self, matrix: np.ndarray, principal: np.ndarray) -> np.ndarray:
        frame = self._frame(matrix)
        return frame @ np.diag(principal) @ frame.T

    # The parts

    def _body(self, b: int) -> Body:
        model, data = self.model, self.data
        return Body(
            self._name("body", b),
            b,
            self.index[b],
            place=self._place(data.xpos[b]),
            mass=float(model.body_mass[b]),
            centre=self._place(data.xipos[b]),
            inertia=self._spread(data.ximat[b], model.body_inertia[b]),
            parent=self.index.get(model.body_parentid[b], -1),
        )

    def _joint(self, j: int) -> Joint:
        body, kind = self.index[self.model.jnt_bodyid[j]], _JOINT_KINDS[self.model.jnt_type[j]]
        axis, anchor = self.rotation.T @ self.data.xaxis[j], self._place(self.data.xanchor[j])
        return Joint(self._name("joint", j), j, body, kind, axis, anchor)

    def _shape(self, g: int) -> Shape:
        model, body = self.model, self.index[self.model.geom_bodyid[g]]
        kind = mujoco.mjtGeom(int(model.geom_type[g])).name.removeprefix("mjGEOM_").lower()
        touches = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        place = self._place(self.data.geom_xpos[g])
        return Shape(self._name("geom", g), g, body, place, self._extent(g, kind), kind, touches)

    def _extent(self, g: int, kind: str) -> np.ndarray:
        """Squared half sizes as a tensor, the same for equivalent poses of a shape; of a mesh: its spread."""
        model, matrix = self.model, self.data.geom_xmat[g]
        if kind == "mesh":
            mesh = model.geom_dataid[g]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            vertices = model.mesh_vert[first : first + count].astype(float)
            frame = self._frame(matrix)
            return frame @ (vertices.T @ vertices / count) @ frame.T
        a, b, c = model.geom_size[g]
        sizes = {"sphere": (a, a, a), "capsule": (a, a, b), "cylinder": (a, a, b)}.get(kind, (a, b, c))
        return self._spread(matrix, np.square(sizes))

    def _site(self, s: int) -> Site:
        body = self.index[self.model.site_bodyid[s]]
        return Site(self._name("site", s), s, body, self._place(self.data.site_xpos[s]))

    def _actuator(self, a: int) -> Actuator:
        model = self.model
        target, gear = int(model.actuator_trnid[a, 0]), model.actuator_gear[a]
        name, transmission = self._name("actuator", a), int(model.actuator_trntype[a])
        if transmission == mujoco.mjtTrn.mjTRN_JOINT:
            kind, body, wrench = "joint", model.jnt_bodyid[target], gear[:1]
        elif transmission == mujoco.mjtTrn.mjTRN_SITE and model.actuator_trnid[a, 1] < 0:
            frame = self._frame(self.data.site_xmat[target])
            kind, body = "site", model.site_bodyid[target]
            wrench = np.concatenate([frame @ gear[:3], frame @ gear[3:]])
        else:
            return Actuator(name, a, -1, "another transmission")
        what = self._name(kind, target)
        return Actuator(name, a, self.index.get(body, -1), kind, what, tuple(wrench.tolist()))

    def _left_out(self) -> list[str]:
        counts = {
            "equality constraints": self.model.neq,
            "tendons": self.model.ntendon,
            "explicit contact pairs": self.model.npair,
        }
        return [f"{count} {what}" for what, count in counts.items() if count]
