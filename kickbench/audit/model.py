"""How symmetric a robot is: what it and its mirror image differ in, with sizes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

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
_GEOMETRY = {"body": "centre inertia", "joint": "axis anchor", "geom": "place extent", "site": "place"}
"""What is compared of a part's geometry, as it is given in the frame of the robot's first body."""
_LENGTHS = {"place": "place", "centre": "centre of mass", "anchor": "anchor"}


def derive_scene(task: CompiledTask) -> Derivation:
    """Derives the reflection of the robot in a task's scene, servos included."""
    return derive(read_parts(task.scene.model, ROBOT))


def model_rows(task: CompiledTask, derivation: Derivation) -> Iterator[Row]:
    """Rows of bodies, joints, actuators, soles, contact exclusions and randomisation."""
    comparer, shown = _Comparer(task, derivation), {"actuator": "servo ", "site": "site "}
    for kind, (parts, matches) in derivation.groups.items():
        places = {match.name: place for place, match in enumerate(matches)}
        for index, match in enumerate(matches):
            is_second = match.partner is not None and places[match.partner] < index
            is_sole = kind != "site" or match.name.startswith("kickbench_")
            if kind != "geom" and is_sole and not is_second and getattr(parts[index], "kind", "") != "free":
                names = [match.name] if match.partner in (None, match.name) else [match.name, match.partner]
                name = shown.get(kind, "") + ", ".join(names).replace("kickbench_", "")
                yield _row(name, comparer.differences(kind, index, match))
    yield comparer.exclusions()
    for what in derivation.parts.left_out:
        yield Row("model", what, "not compared", detail="the audit does not know how they mirror")
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
        self.model, self.layout, self.here = task.scene.model, task.scene.layout, derivation.groups
        self.image, self.size = mirror_image(self.model, derivation), derivation.parts.size
        self.there = replace(derivation, parts=read_parts(self.image, ROBOT)).groups

    def differences(self, kind: str, index: int, match: Match) -> Iterator[Comparison]:
        """What a part and its image differ in; of a body, its shapes too."""
        if match.partner is None:
            yield np.inf, match.reason
            return
        mine, theirs = (groups[kind][0][index] for groups in (self.here, self.there))
        names = _GEOMETRY.get(kind, "").split()
        # Where the frame of a body with mass lies is a matter of drawing.
        if kind == "body" and not mine.mass:
            names.append("place")
        for name in names:
            yield self._geometry(name, mine, theirs, match)
        yield from self._figures(kind, mine.row)
        if kind == "actuator":
            yield from self._action(index, match)
        elif kind == "body":
            yield from self._shapes(mine.body)

    def _figures(self, kind: str, row: int) -> Iterator[Comparison]:
        """What the arrays of the two models say of a part."""
        model, rows = self.model, {kind: row}
        if kind == "joint":
            rows = {"jnt": row, "qpos": model.jnt_qposadr[row], "dof": model.jnt_dofadr[row]}
        for prefix, place in rows.items():
            for name in FIGURES.get(prefix, "").split():
                values = (getattr(of, name)[place] for of in (model, self.image))
                yield _against(name.partition("_")[2] or name, *values, least=float(prefix == "qpos"))

    def _geometry(self, name: str, mine: Any, theirs: Any, match: Match) -> Comparison:
        apart = getattr(mine, name) - getattr(theirs, name)
        if name == "anchor":  # that of a slide has no effect, nor that of a hinge along its axis
            apart = (apart - (apart @ mine.axis) * mine.axis) * (mine.kind == "hinge")
        error = float(np.abs(apart).max())
        if name not in _LENGTHS:
            share = error / max(*(np.abs(getattr(part, name)).max() for part in (mine, theirs)), 1e-12)
            return share, f"{name} {100 * share:.2g} %"
        if match.partner == match.name and name != "anchor":
            return error / self.size, f"{_LENGTHS[name]} {500 * error:.3g} mm off the mirror plane"
        return error / self.size, f"{_LENGTHS[name]} {1000 * error:.3g} mm"

    def _shapes(self, body: int) -> Iterator[Comparison]:
        for index, (shape, match) in enumerate(zip(*self.here["geom"], strict=True)):
            if shape.body == body and shape.touches:
                found = self.differences("geom", index, match)
                yield from ((error, f"{shape.name}: {words}") for error, words in found)

    def _action(self, place: int, match: Match) -> Iterator[Comparison]:
        """What the robot file says of a servo's action."""
        partner = self.layout.actuator_names.index(match.partner)
        target, scale = self.layout.default_target, self.layout.action_scale
        yield _against("default target", target[place], match.sign * target[partner], 1.0)
        yield _against("action scale", scale[place], scale[partner])

    def exclusions(self) -> Row:
        """Contact exclusions whose mirror image is not among them."""
        odd = set(self.model.exclude_signature.tolist()) - set(self.image.exclude_signature.tolist())
        bodies = [self.model.body(body).name.removeprefix(ROBOT) for body in range(self.model.nbody)]
        names = [f"{bodies[pair >> 16]} and {bodies[pair & 0xFFFF]}" for pair in sorted(odd)]
        detail = f"no mirror image among them: {'; '.join(names)}" if odd else ""
        verdict = "unequal" if odd else "ok"
        return Row("model", "contact exclusions", verdict, float(len(odd)), 0.0, "pairs", detail=detail)


def _against(name: str, mine: ArrayLike, theirs: ArrayLike, least: float = 0.0) -> Comparison:
    """The number that differs most and what it would be in the mirror: "range -2.1 against -1.9"."""
    both = np.array([np.ravel(mine), np.ravel(theirs)], dtype=float)
    off = np.abs(both[0] - both[1])
    place, size = int(off.argmax()), max(np.abs(both).max(), least)
    return float(off[place] / (size or 1.0)), f"{name} {both[0, place]:.5g} against {both[1, place]:.5g}"


def _row(name: str, compared: Iterable[Comparison]) -> Row:
    ranked = sorted(compared, reverse=True)
    bad = [words for relative, words in ranked if relative > _TOLERANCE]
    detail = "; ".join(bad[:3]) + (f"; {len(bad) - 3} more" if len(bad) > 3 else "")
    return Row("model", name, "unequal" if bad else "ok", ranked[0][0], _TOLERANCE, detail=detail)
