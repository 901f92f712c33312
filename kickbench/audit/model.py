"""How symmetric a robot is: what it and its mirror image differ in, with sizes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from kickbench.audit.findings import Row
from kickbench.config.terms import RandomizationParams
from kickbench.config.yamltree import flow_yaml
from kickbench.envs.compiled_task import CompiledTask
from kickbench.sim.mirror_image import FIGURES, mirror_image
from kickbench.sim.read_parts import read_parts
from kickbench.sim.sensors import ROBOT
from kickbench.symmetry.derive import Derivation, Match, derive

Comparison = tuple[float, str]
"""Relative difference of a quantity from that of the mirror image, and the difference in words."""
_TOLERANCE = 1e-5
"""Relative; model files round to six or seven digits."""
_POSITIONS = ("jnt_range", "qpos0", "qpos_spring")
"""Figures in rad or m."""


def derive_scene(task: CompiledTask) -> Derivation:
    """Derives the reflection of the robot in a task's scene, servos included."""
    return derive(read_parts(task.scene.model, ROBOT))


def model_rows(task: CompiledTask, derivation: Derivation) -> Iterator[Row]:
    """Rows of bodies, joints, actuators, soles, contact exclusions and randomisation."""
    yield from _Comparer(task, derivation).rows()
    yield from _randomization_rows(task)


def _randomization_rows(task: CompiledTask) -> Iterator[Row]:
    """Rows of randomisations whose left side has another range than the right one.

    Equal ranges are symmetric, those of `sensor_bias` too: it signs the biases of the right side.
    """
    for name, params in task.spec.randomization.active(RandomizationParams).items():
        sides = params.model_dump(mode="json", include={"left", "right"})
        if len({flow_yaml(side) for side in sides.values()}) > 1:
            detail = ", ".join(f"{side} {flow_yaml(sides[side])}" for side in ("left", "right"))
            yield Row("model", f"randomization {name}", "unequal", detail=detail)


class _Comparer:
    """Compares every part of a robot with what stands in its place in the mirror image of the model."""

    def __init__(self, task: CompiledTask, derivation: Derivation) -> None:
        self.model, self.layout, self.derivation = task.scene.model, task.scene.layout, derivation
        self.image = mirror_image(self.model, derivation)
        self.here, self.there = derivation.parts, read_parts(self.image, ROBOT)

    def rows(self) -> Iterator[Row]:
        found, here = self.derivation, self.here
        for place, match in _speakers(found.bodies):
            yield _row(_orbit(match), match, self._body(place, match))
        for place, match in _speakers(found.joints):
            if here.joints[place].kind != "free":
                yield _row(_orbit(match), match, self._joint(place))
        for place, match in _speakers(found.actuators):
            yield _row(f"servo {_orbit(match)}", match, self._servo(place, match))
        for place, match in _speakers(found.sites):
            if match.name.startswith("kickbench_"):
                apart = self._apart("place", here.sites[place].place - self.there.sites[place].place, match)
                yield _row(f"site {_orbit(match)}".replace("kickbench_", ""), match, [apart])
        yield self._exclusions()
        for what in here.left_out:
            yield Row("model", what, "not compared", detail="the audit does not know how they mirror")

    def _body(self, place: int, match: Match) -> Iterator[Comparison]:
        mine, theirs = self.here.bodies[place], self.there.bodies[place]
        if not mine.mass:  # where the frame of a body with mass lies is a matter of drawing
            yield self._apart("place", mine.place - theirs.place, match)
        yield from self._figures("body", mine.row)
        yield self._apart("centre of mass", mine.centre - theirs.centre, match)
        yield _share("inertia", mine.inertia, theirs.inertia)
        for index, shape in enumerate(self.here.shapes):
            if shape.body == mine.body and shape.touches:
                yield from ((error, f"{shape.name}: {words}") for error, words in self._shape(index))

    def _shape(self, place: int) -> Iterator[Comparison]:
        mine, theirs = self.here.shapes[place], self.there.shapes[place]
        match = self.derivation.shapes[place]
        if match.partner is None:
            yield np.inf, "it has no mirror image"
            return
        yield self._apart("place", mine.place - theirs.place, match)
        yield _share("extent", mine.extent, theirs.extent)
        yield from self._figures("geom", mine.row)

    def _joint(self, place: int) -> Iterator[Comparison]:
        mine, theirs = self.here.joints[place], self.there.joints[place]
        yield _share("axis", mine.axis, theirs.axis)
        if mine.kind == "hinge":  # the anchor of a slide has no effect, nor that of a hinge along its axis
            apart = mine.anchor - theirs.anchor
            across = float(np.linalg.norm(apart - (apart @ mine.axis) * mine.axis))
            yield across / self.here.size, f"anchor {1000 * across:.3g} mm"
        factor, unit = (180.0 / math.pi, "degrees") if mine.kind == "hinge" else (1.0, "m")
        yield from self._figures("jnt", mine.row, factor, unit)
        yield from self._figures("qpos", self.model.jnt_qposadr[mine.row], factor, unit)
        yield from self._figures("dof", self.model.jnt_dofadr[mine.row])

    def _servo(self, place: int, match: Match) -> Iterator[Comparison]:
        """The actuator, and what the robot file says of its action."""
        yield from self._figures("actuator", place)
        partner = place if match.partner is None else self.layout.actuator_names.index(match.partner)
        target, scale = self.layout.default_target, self.layout.action_scale
        yield _against("default target", target[place], match.sign * target[partner], 1.0)
        yield _against("action scale", scale[place], scale[partner])

    def _figures(self, kind: str, row: int, factor: float = 1.0, unit: str = "") -> Iterator[Comparison]:
        """What the model's arrays say of a part and of its image; angles and lengths in the given unit."""
        for name in FIGURES[kind].split():
            mine, theirs = (np.ravel(getattr(model, name)[row]) for model in (self.model, self.image))
            words, least = name.partition("_")[2] or name, float(kind == "qpos")
            in_unit = (factor, unit) if name in _POSITIONS else (1.0, "")
            yield _against(words, mine, theirs, least, *in_unit)

    def _apart(self, name: str, apart: np.ndarray, match: Match) -> Comparison:
        error = float(np.abs(apart).max())
        if match.partner == match.name:
            return error / self.here.size, f"{name} {1000 * error / 2:.3g} mm off the mirror plane"
        return error / self.here.size, f"{name} {1000 * error:.3g} mm"

    def _exclusions(self) -> Row:
        odd = set(self.model.exclude_signature.tolist()) - set(self.image.exclude_signature.tolist())
        bodies = [self.model.body(body).name.removeprefix(ROBOT) for body in range(self.model.nbody)]
        names = [f"{bodies[pair >> 16]} and {bodies[pair & 0xFFFF]}" for pair in sorted(odd)]
        detail = f"no mirror image among them: {'; '.join(names)}" if odd else ""
        verdict = "unequal" if odd else "ok"
        return Row("model", "contact exclusions", verdict, float(len(odd)), 0.0, "pairs", detail=detail)


def _against(
    name: str, mine: np.ndarray, theirs: np.ndarray, least: float = 0.0, factor: float = 1.0, unit: str = ""
) -> Comparison:
    """The number that differs most and what it would be in the mirror: "range -120 against -110 degrees"."""
    mine, theirs = np.ravel(mine).astype(float), np.ravel(theirs).astype(float)
    off, size = np.abs(mine - theirs), max(np.abs(mine).max(), np.abs(theirs).max(), least)
    place = int(off.argmax())
    words = f"{name} {factor * mine[place]:.5g} against {factor * theirs[place]:.5g} {unit}".rstrip()
    return float(off[place] / (size or 1.0)), words


def _share(name: str, mine: np.ndarray, theirs: np.ndarray) -> Comparison:
    """The difference of two vectors or tensors relative to their size."""
    relative = float(np.abs(mine - theirs).max() / max(np.abs(mine).max(), np.abs(theirs).max(), 1e-12))
    return relative, f"{name} {100 * relative:.2g} %"


def _speakers(matches: Sequence[Match]) -> Iterator[tuple[int, Match]]:
    """Places of the parts in the model's order; of a pair only the first."""
    places = {match.name: place for place, match in enumerate(matches)}
    for place, match in enumerate(matches):
        if match.partner is None or place <= places[match.partner]:
            yield place, match


def _row(name: str, match: Match, compared: Iterable[Comparison]) -> Row:
    if match.partner is None:
        return Row("model", name, "unequal", np.inf, _TOLERANCE, detail=match.reason)
    ranked = sorted(compared, reverse=True)
    bad = [words for relative, words in ranked if relative > _TOLERANCE]
    detail = "; ".join(bad[:3]) + (f"; {len(bad) - 3} more" if len(bad) > 3 else "")
    return Row("model", name, "unequal" if bad else "ok", ranked[0][0], _TOLERANCE, detail=detail)


def _orbit(match: Match) -> str:
    return match.name if match.partner in (None, match.name) else f"{match.name}, {match.partner}"
