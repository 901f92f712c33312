"""Reads the parts of a compiled model in the frame of its first body, in the reference pose."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

# pyright: reportAttributeAccessIssue=false
import mujoco
import numpy as np

from kickbench.errors import KickbenchError
from kickbench.symmetry.model_parts import (
    Actuator,
    Body,
    Joint,
    JointKind,
    ModelParts,
    Quantity,
    Shape,
    Site,
)

_JOINT_KINDS: dict[int, JointKind] = {
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
}
_UNLIMITED = np.array([-np.inf, np.inf])
_UNSUPPORTED_DRIVES = {
    mujoco.mjtTrn.mjTRN_TENDON: "the tendon",
    mujoco.mjtTrn.mjTRN_SLIDERCRANK: "a slider-crank",
}


def read_parts(model: mujoco.MjModel, prefix: str = "") -> ModelParts:
    """Reads a model's parts.

    The frame is that of the first body: its own axes if a free joint carries it, else the world's axes
    through its origin. Parts that belong to no body (a floor) are left out.

    Args:
        model: Compiled model.
        prefix: Only bodies whose names begin so are read, and names lose it: the robot's part of a scene.
    """
    return PartsReader(model, prefix).read()


def compile_model(path: str | Path) -> mujoco.MjModel:
    """Compiles an MJCF file.

    Raises:
        KickbenchError: MuJoCo cannot read or compile the model, it has no body, or a robot file cannot say it.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        name_parts(spec)
        model = spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise KickbenchError(f"{path}: MuJoCo cannot read this model: {reason}") from None
    if what := next(unsupported(spec), None):
        raise KickbenchError(f"{path}: {what}")
    if model.nbody < 2:
        raise KickbenchError(f"{path}: the model has no body")
    return model


def name_parts(spec: mujoco.MjSpec) -> None:
    """Names what has no name: `body_3`, and `BODY:0` for the first joint of a body."""
    for index, body in enumerate(spec.bodies[1:], start=1):
        body.name = body.name or f"body_{index}"
        for rank, joint in enumerate(body.joints):
            if joint.type != mujoco.mjtJoint.mjJNT_FREE:
                joint.name = joint.name or f"{body.name}:{rank}"


def unsupported(spec: mujoco.MjSpec) -> Iterator[str]:
    """What no robot file can say of a model: joints without a coordinate of their own, drives of no joint."""
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_BALL:
            yield f"the joint '{joint.name}' is a ball joint; expected hinge, slide or free joints"
    for index, actuator in enumerate(spec.actuators):
        if drive := _UNSUPPORTED_DRIVES.get(actuator.trntype):
            name = part_name(actuator, index)
            yield f"the actuator {name} drives {drive}; the servos of a robot file drive joints or the base"


def part_name(part: mujoco.MjsElement, index: int) -> str:
    """A name in quotes, or the number of what has none."""
    return f"'{part.name}'" if part.name else f"number {index}"


def compile_parts(path: str | Path) -> ModelParts:
    """Reads the parts of an MJCF file.

    Raises:
        KickbenchError: As in `compile_model`.
    """
    return read_parts(compile_model(path))


class PartsReader:
    """Ids of a model's parts, where they are in the reference pose, and the frame that parts are given in."""

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
            size=self.size,
            bodies=tuple(map(self._body, self.bodies)),
            joints=tuple(map(self._joint, self.joints)),
            shapes=tuple(map(self._shape, self.geoms)),
            sites=tuple(map(self._site, self.sites)),
            actuators=tuple(map(self._actuator, range(self.model.nu))),
            exclusions=frozenset(self._exclusions()),
            left_out=tuple(self._left_out()),
        )

    @cached_property
    def size(self) -> float:
        """Largest distance of a part from the origin, m."""
        data = self.data
        places = [data.xpos[self.bodies], data.xipos[self.bodies], data.geom_xpos[self.geoms]]
        return float(np.linalg.norm(np.concatenate(places) - self.origin, axis=1).max(initial=0.0)) or 1.0

    # Names, and what is given in the world's frame in the frame of the first body

    def _name(self, kind: str, index: int) -> str:
        name = getattr(self.model, kind)(index).name
        return name.removeprefix(self.prefix) or f"{kind} {index}"

    def _place(self, point: np.ndarray, name: str = "place") -> Quantity:
        return Quantity(name, self.rotation.T @ (point - self.origin), "point", "m", self.size)

    def _frame(self, matrix: np.ndarray) -> np.ndarray:
        return self.rotation.T @ matrix.reshape(3, 3)

    def _spread(self, matrix: np.ndarray, principal: np.ndarray) -> np.ndarray:
        frame = self._frame(matrix)
        return frame @ np.diag(principal) @ frame.T

    # The parts

    def _body(self, b: int) -> Body:
        model, data = self.model, self.data
        inertia = self._spread(data.ximat[b], model.body_inertia[b])
        quantities = (
            self._place(data.xpos[b]),
            Quantity("mass", model.body_mass[b], "scalar", "kg"),
            self._place(data.xipos[b], "centre of mass"),
            Quantity("inertia", inertia, "tensor", "kg m^2"),
            Quantity("gravity compensation", model.body_gravcomp[b], "scalar"),
        )
        parent = self.index.get(model.body_parentid[b], -1)
        return Body(self._name("body", b), self.index[b], quantities, parent)

    def _joint(self, j: int) -> Joint:
        model, data = self.model, self.data
        kind, name, body = _JOINT_KINDS[model.jnt_type[j]], self._name("joint", j), model.jnt_bodyid[j]
        if kind in ("free", "ball"):
            return Joint(name, self.index[body], (), kind)
        law, angle = ("axial", "rad") if kind == "hinge" else ("polar", "m")
        dof, place = model.jnt_dofadr[j], model.jnt_qposadr[j]
        limits = model.jnt_range[j] if model.jnt_limited[j] else _UNLIMITED
        effort = model.jnt_actfrcrange[j] if model.jnt_actfrclimited[j] else _UNLIMITED
        quantities = (
            Quantity("axis", self.rotation.T @ data.xaxis[j], law, "", 1.0),
            self._place(data.xanchor[j], "anchor"),
            Quantity("range", limits, "range", angle),
            Quantity("reference", model.qpos0[place], "signed", angle, 1.0),
            Quantity("spring reference", model.qpos_spring[place], "signed", angle, 1.0),
            Quantity("stiffness", model.jnt_stiffness[j], "scalar"),
            Quantity("damping", model.dof_damping[dof], "scalar"),
            Quantity("armature", model.dof_armature[dof], "scalar"),
            Quantity("friction loss", model.dof_frictionloss[dof], "scalar"),
            Quantity("effort range", effort, "range"),
            Quantity("limit solref", model.jnt_solref[j], "scalar"),
            Quantity("limit solimp", model.jnt_solimp[j], "scalar"),
        )
        return Joint(name, self.index[body], quantities, kind)

    def _shape(self, g: int) -> Shape:
        model = self.model
        kind = mujoco.mjtGeom(int(model.geom_type[g])).name.removeprefix("mjGEOM_").lower()
        extent = Quantity("extent", self._extent(g, kind), "tensor", "m^2")
        quantities = [self._place(self.data.geom_xpos[g]), extent]
        touches = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        if touches:
            names = ["friction", "solref", "solimp", "margin", "gap"]
            quantities += [Quantity(name, getattr(model, f"geom_{name}")[g], "scalar") for name in names]
            names = ["condim", "priority", "contype", "conaffinity"]
            quantities += [Quantity(name, getattr(model, f"geom_{name}")[g], "exact") for name in names]
        body = self.index[model.geom_bodyid[g]]
        return Shape(self._name("geom", g), body, tuple(quantities), kind, touches)

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
        return Site(self._name("site", s), body, (self._place(self.data.site_xpos[s]),))

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
            return Actuator(name, -1, self._servo(a), "another transmission", "", ())
        what = self._name(kind, target)
        return Actuator(name, self.index.get(body, -1), self._servo(a), kind, what, tuple(wrench.tolist()))

    def _servo(self, a: int) -> tuple[Quantity, ...]:
        model = self.model
        force = model.actuator_forcerange[a] if model.actuator_forcelimited[a] else _UNLIMITED
        control = model.actuator_ctrlrange[a] if model.actuator_ctrllimited[a] else _UNLIMITED
        bias = model.actuator_biasprm[a]
        return (
            Quantity("gain", model.actuator_gainprm[a], "scalar"),
            Quantity("bias offset", bias[0], "signed"),
            Quantity("bias", bias[1:], "scalar"),
            Quantity("dynamics", model.actuator_dynprm[a], "scalar"),
            Quantity("damping", np.ravel(model.actuator_damping[a]), "scalar"),
            Quantity("force range", force, "range"),
            Quantity("control range", control, "range"),
        )

    def _exclusions(self) -> Iterator[frozenset[str]]:
        for sign in self.model.exclude_signature.tolist():
            pair = sign >> 16, sign & 0xFFFF
            if set(pair) & set(self.index):
                yield frozenset(self._name("body", body) for body in pair)

    def _left_out(self) -> list[str]:
        counts = {
            "equality constraints": self.model.neq,
            "tendons": self.model.ntendon,
            "explicit contact pairs": self.model.npair,
        }
        return [f"{count} {what}" for what, count in counts.items() if count]
