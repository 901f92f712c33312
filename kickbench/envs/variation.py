"""From values by side to fields of the model: what the randomisations of a robot's hardware change in the physics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import torch
from torch import Tensor

from kickbench.sim.build import Scene, servo_law
from kickbench.sim.engine import ModelField
from kickbench.sim.layout import NO_SIDE, Servo

_SERVO = ("servo_stiffness", "servo_damping", "motor_strength")


class ModelVariation:
    """Computes the model fields of worlds whose robots differ; see `Starts.by_side`."""

    def __init__(self, scene: Scene, device: torch.device) -> None:
        """Copies the figures of the compiled robot to a device."""
        layout, model = scene.layout, scene.model

        def whole(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=torch.int64, device=device)

        def real(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float64, device=device)

        sides = [torch.full((len(geoms),), side) for side, geoms in enumerate(layout.foot_geoms)]
        self._foot_sides = torch.cat(sides).to(device) if sides else whole([])
        self._foot_geoms = whole([geom for geoms in layout.foot_geoms for geom in geoms])
        self._bodies = whole([body for body, side in enumerate(layout.body_sides) if side != NO_SIDE])
        self._body_sides = whole(layout.body_sides)[self._bodies]
        self._mass = real(model.body_mass)[self._bodies]
        self._inertia = real(model.body_inertia)[self._bodies]
        self._actuators, self._actuator_sides = whole(range(model.nu)), whole(layout.actuator_sides)
        servos = layout.servos
        self._is_velocity = torch.as_tensor(servos.is_velocity, device=device)
        self._kp, self._kd = real(servos.kp), real(servos.kd)
        self._effort, self._velocity_limit = real(servos.effort), real(servos.velocity_limit)

    def __call__(self, by_side: Mapping[str, Tensor]) -> tuple[ModelField, ...]:
        """The fields that follow from values by side, each [N, 2 or 3]."""
        return tuple(self._fields(by_side))

    def _fields(self, by_side: Mapping[str, Tensor]) -> Iterator[ModelField]:
        if "foot_friction" in by_side:
            friction = by_side["foot_friction"][:, self._foot_sides]
            yield ModelField("geom_friction", self._foot_geoms, friction, column=0)
        if "link_mass" in by_side:
            factor = by_side["link_mass"][:, self._body_sides]
            yield ModelField("body_mass", self._bodies, factor * self._mass)
            yield ModelField("body_inertia", self._bodies, factor.unsqueeze(2) * self._inertia)
        if any(name in by_side for name in _SERVO):
            yield from self._servos(by_side)

    def _servos(self, by_side: Mapping[str, Tensor]) -> Iterator[ModelField]:
        one = self._kp.new_ones(1, len(self._kp))
        stiffness, damping, strength = (
            by_side[name][:, self._actuator_sides] if name in by_side else one for name in _SERVO
        )
        kp, kd, effort = stiffness * self._kp, damping * self._kd, strength * self._effort
        worlds = max(len(values) for values in by_side.values())
        law = servo_law(Servo(self._is_velocity, kp, kd, effort, self._velocity_limit))
        for (name, column), values in law.items():
            yield ModelField(name, self._actuators, values.expand(worlds, -1), column)
