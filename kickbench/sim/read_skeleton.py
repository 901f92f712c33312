"""Reads the skeleton of a compiled model: its parts in the frame of its first body, in the reference pose."""

from __future__ import annotations

from dataclasses import dataclass, field
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
    Law,
    ModelParts,
    Quantity,
    Sensor,
    Shape,
    Site,
)

_JOINT_KINDS: dict[int, JointKind] = {
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
}
_OBJECTS = {
    int(mujoco.mjtObj.mjOBJ_BODY): "body",
    int(mujoco.mjtObj.mjOBJ_XBODY): "body",
    int(mujoco.mjtObj.mjOBJ_GEOM): "shape",
    int(mujoco.mjtObj.mjOBJ_SITE): "site",
    int(mujoco.mjtObj.mjOBJ_JOINT): "joint",
    int(mujoco.mjtObj.mjOBJ_ACTUATOR): "actuator",
}
_LAWS: dict[Law, str] = {
    "scalar": "TOUCH RANGEFINDER CLOCK E_POTENTIAL E_KINETIC GEOMDIST INSIDESITE JOINTLIMITPOS JOINTLIMITFRC",
    "signed": "JOINTPOS JOINTVEL JOINTACTFRC ACTUATORPOS ACTUATORVEL ACTUATORFRC",
    "polar": "ACCELEROMETER VELOCIMETER FORCE FRAMEPOS FRAMELINVEL FRAMELINACC SUBTREECOM SUBTREELINVEL",
    "axial": "GYRO TORQUE FRAMEANGVEL FRAMEANGACC SUBTREEANGMOM",
}
_LAW_OF: dict[int, Law] = {
    int(getattr(mujoco.mjtSensor, f"mjSENS_{name}")): law
    for law, names in _LAWS.items()
    for name in names.split()
}
_LOCAL = {
    int(getattr(mujoco.mjtSensor, f"mjSENS_{name}"))
    for name in ["ACCELEROMETER", "VELOCIMETER", "GYRO", "FORCE", "TORQUE", "MAGNETOMETER"]
}
"""Sensors whose vector is in the frame of their site."""


def read_skeleton(model: mujoco.MjModel, prefix: str = "") -> ModelParts:
    """Reads a model's skeleton.

    The frame is that of the first body: its own axes if a free joint carries it, else the world's axes through its
    origin. Parts that belong to no body (a floor) are left out.

    Args:
        model: Compiled model.
        prefix: Only bodies whose names begin so are read, and names lose it: the robot's part of a scene.
    """
    return _Reader(model, prefix).read()


def compile_skeleton(path: str | Path) -> ModelParts:
    """Reads the skeleton of an MJCF file.

    Raises:
        KickbenchError: MuJoCo cannot read or compile the model, or it has no body.
    """
    try:
        model = mujoco.MjSpec.from_file(str(path)).compile()
    except ValueError as error:
        raise KickbenchError(
            f"{path}: MuJoCo cannot read this model: {' '.join(str(error).split())}"
        ) from None
    skeleton = read_skeleton(model)
    if not skeleton.bodies:
        raise KickbenchError(f"{path}: the model has no body")
    return skeleton


@dataclass
class _Reader:
    model: mujoco.MjModel
    prefix: str
    data: mujoco.MjData = field(init=False)

    def __post_init__(self) -> None:
        model = self.model
        self.data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)
        named = [(b, model.body(b).name) for b in range(1, model.nbody)]
        self.bodies = [b for b, name in named if name.startswith(self.prefix)]
        self.index = {b: i for i, b in enumerate(self.bodies)}
        self.origin, self.rotation = np.zeros(3), np.eye(3)
        if self.bodies:
            root = self.bodies[0]
            self.origin = self.data.xpos[root].copy()
            joint = model.body_jntadr[root]
            if joint >= 0 and _JOINT_KINDS[model.jnt_type[joint]] == "free":
                self.rotation = self.data.xmat[root].reshape(3, 3).copy()
        places = [self.data.xpos[self.bodies], self.data.xipos[self.bodies]]
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] in self.index]
        places.append(self.data.geom_xpos[geoms])
        distances = [np.linalg.norm(p - self.origin, axis=1).max(initial=0.0) for p in places]
        self.size = float(max(distances, default=0.0)) or 1.0

    def read(self) -> ModelParts:
        model = self.model
        of_robot = self.index
        joints = [j for j in range(model.njnt) if model.jnt_bodyid[j] in of_robot]
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] in of_robot]
        sites = [s for s in range(model.nsite) if model.site_bodyid[s] in of_robot]
        return ModelParts(
            size=self.size,
            bodies=tuple(self._body(b) for b in self.bodies),
            joints=tuple(self._joint(j) for j in joints),
            shapes=tuple(self._shape(g) for g in geoms),
            sites=tuple(self._site(s) for s in sites),
            actuators=tuple(self._actuator(a) for a in range(model.nu)),
            sensors=tuple(self._sensor(s) for s in range(model.nsensor)),
            exclusions=frozenset(self._exclusions()),
            left_out=tuple(self._left_out()),
        )

    def _name(self, kind: str, index: int) -> str:
        name = getattr(self.model, kind)(index).name
        return name.removeprefix(self.prefix) or f"{kind} {index}"

    def _vector(self, vector: np.ndarray) -> np.ndarray:
        return self.rotation.T @ vector

    def _point(self, place: np.ndarray) -> np.ndarray:
        return self._vector(place - self.origin)

    def _frame(self, matrix: np.ndarray) -> np.ndarray:
        return self.rotation.T @ matrix.reshape(3, 3)

    def _spread(self, matrix: np.ndarray, principal: np.ndarray) -> np.ndarray:
        frame = self._frame(matrix)
        return frame @ np.diag(principal) @ frame.T

    def _body(self, b: int) -> Body:
        model, data = self.model, self.data
        inertia = self._spread(data.ximat[b], model.body_inertia[b])
        quantities = (
            Quantity("place", self._point(data.xpos[b]), "point", "m", self.size),
            Quantity("mass", model.body_mass[b], "scalar", "kg"),
            Quantity("centre of mass", self._point(data.xipos[b]), "point", "m", self.size),
            Quantity("inertia", inertia, "tensor", "kg m^2"),
            Quantity("gravity compensation", model.body_gravcomp[b], "scalar"),
        )
        parent = self.index.get(model.body_parentid[b], -1)
        return Body(self._name("body", b), self.index[b], quantities, parent)

    def _joint(self, j: int) -> Joint:
        model, data = self.model, self.data
        kind = _JOINT_KINDS[model.jnt_type[j]]
        body, dof, place = self.index[model.jnt_bodyid[j]], model.jnt_dofadr[j], model.jnt_qposadr[j]
        if kind in ("free", "ball"):
            return Joint(self._name("joint", j), body, (), kind)
        law, angle = ("axial", "rad") if kind == "hinge" else ("polar", "m")
        limits = model.jnt_range[j] if model.jnt_limited[j] else np.array([-np.inf, np.inf])
        effort = np.array([-np.inf, np.inf])
        if model.jnt_actfrclimited[j]:
            effort = model.jnt_actfrcrange[j]
        quantities = (
            Quantity("axis", self._vector(data.xaxis[j]), law, "", 1.0),
            Quantity("anchor", self._point(data.xanchor[j]), "point", "m", self.size),
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
        return Joint(self._name("joint", j), body, quantities, kind)

    def _shape(self, g: int) -> Shape:
        model, data = self.model, self.data
        kind = mujoco.mjtGeom(int(model.geom_type[g])).name.removeprefix("mjGEOM_").lower()
        place, extent = self._point(data.geom_xpos[g]), self._extent(g, kind)
        quantities = [
            Quantity("place", place, "point", "m", self.size),
            Quantity("extent", extent, "tensor", "m^2"),
        ]
        touches = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        if touches:
            names = ["friction", "solref", "solimp", "margin", "gap"]
            quantities += [Quantity(name, getattr(model, f"geom_{name}")[g], "scalar") for name in names]
            names = ["condim", "priority", "contype", "conaffinity"]
            quantities += [Quantity(name, getattr(model, f"geom_{name}")[g], "exact") for name in names]
        body = self.index[model.geom_bodyid[g]]
        return Shape(self._name("geom", g), body, tuple(quantities), kind, touches)

    def _extent(self, g: int, kind: str) -> np.ndarray:
        """Squared half sizes as a tensor, which knows nothing of a shape's own symmetries; of a mesh: its spread."""
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
        place = Quantity("place", self._point(self.data.site_xpos[s]), "point", "m", self.size)
        return Site(self._name("site", s), self.index[self.model.site_bodyid[s]], (place,))

    def _actuator(self, a: int) -> Actuator:
        model = self.model
        target, gear = int(model.actuator_trnid[a, 0]), model.actuator_gear[a]
        name, transmission = self._name("actuator", a), int(model.actuator_trntype[a])
        if transmission == mujoco.mjtTrn.mjTRN_JOINT:
            kind, what, wrench = "joint", self._name("joint", target), (float(gear[0]),)
            body = self.index.get(model.jnt_bodyid[target], -1)
        elif transmission == mujoco.mjtTrn.mjTRN_SITE and model.actuator_trnid[a, 1] < 0:
            frame = self._frame(self.data.site_xmat[target])
            kind, what = "site", self._name("site", target)
            wrench = (*(frame @ gear[:3]), *(frame @ gear[3:]))
            body = self.index.get(model.site_bodyid[target], -1)
        else:
            kind, what, wrench, body = "another transmission", "", (), -1
        return Actuator(name, body, self._servo(a), kind, what, tuple(map(float, wrench)))

    def _servo(self, a: int) -> tuple[Quantity, ...]:
        model, unlimited = self.model, np.array([-np.inf, np.inf])
        force = model.actuator_forcerange[a] if model.actuator_forcelimited[a] else unlimited
        control = model.actuator_ctrlrange[a] if model.actuator_ctrllimited[a] else unlimited
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

    def _sensor(self, s: int) -> Sensor:
        model = self.model
        kind, objects = int(model.sensor_type[s]), []
        for types, ids in (
            (model.sensor_objtype, model.sensor_objid),
            (model.sensor_reftype, model.sensor_refid),
        ):
            if ids[s] >= 0 and int(types[s]) in _OBJECTS:
                what = _OBJECTS[int(types[s])]
                objects.append((what, self._name({"shape": "geom"}.get(what, what), int(ids[s]))))
        name = mujoco.mjtSensor(kind).name.removeprefix("mjSENS_").lower()
        return Sensor(
            self._name("sensor", s),
            -1,
            (),
            name,
            _LAW_OF.get(kind),
            tuple(objects),
            self._sensor_frame(s, kind),
        )

    def _sensor_frame(self, s: int, kind: int) -> np.ndarray:
        model, data = self.model, self.data
        if kind in _LOCAL:
            return self._frame(data.site_xmat[model.sensor_objid[s]])
        reference = int(model.sensor_reftype[s]), int(model.sensor_refid[s])
        frames = {"body": data.xmat, "shape": data.geom_xmat, "site": data.site_xmat}
        what = _OBJECTS.get(reference[0], "")
        if reference[1] >= 0 and what in frames:
            return self._frame(frames[what][reference[1]])
        return self.rotation.T

    def _exclusions(self) -> list[frozenset[str]]:
        pairs = [(int(sign) >> 16, int(sign) & 0xFFFF) for sign in self.model.exclude_signature]
        return [
            frozenset(self._name("body", b) for b in pair) for pair in pairs if set(pair) & set(self.index)
        ]

    def _left_out(self) -> list[str]:
        counts = {
            "equality constraints": self.model.neq,
            "tendons": self.model.ntendon,
            "explicit contact pairs": self.model.npair,
        }
        return [f"{count} {what}" for what, count in counts.items() if count]
