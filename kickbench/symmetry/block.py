"""Writes a derivation as the `symmetry:` block of a robot file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from kickbench.config.yamlio import flow_yaml
from kickbench.symmetry.derive import Derivation, Match
from kickbench.symmetry.representation import BY_NAME, Representation

Columns = tuple[list[str], list[str]]


def kind_of_coordinate(central: bool, sign: int) -> str:
    """Name of the representation of a central coordinate or a pair with the given sign."""
    pick = Representation((0,), (sign,)) if central else Representation((1, 0), (sign, sign))
    return next(name for name, representation in BY_NAME.items() if representation == pick)


def symmetry_block(derivation: Derivation, title: str) -> str:
    """The block as YAML, with what was found and what was not as comments.

    Args:
        derivation: What was derived.
        title: Name of the model.
    """
    root = derivation.skeleton.bodies[0].name
    lines = [f"# Derived from {title}: reflection in the {derivation.plane} plane of '{root}'."]
    lines += [f"# {line}" for line in (*_counts(derivation), *_complaints(derivation))]
    return "\n".join([*lines, "symmetry:", *_tables(derivation)])


def _tables(derivation: Derivation) -> Iterator[str]:
    found: dict[str, Columns] = {name: ([], []) for name in BY_NAME}
    for name, (partner, sign) in derivation.image.items():
        kind = kind_of_coordinate(partner == name, sign)
        if any(name in column for column in found[kind]):
            continue
        left, right = (name, partner) if _is_left(derivation, name, partner) else (partner, name)
        found[kind][0].append(left)
        found[kind][1].append(right)
    for kind, (left, right) in found.items():
        if not left:
            continue
        if kind in ("trivial", "sign"):
            yield f"  {kind}: {flow_yaml(left)}"
        else:
            yield from (f"  {kind}:", f"    left: {flow_yaml(left)}", f"    right: {flow_yaml(right)}")


def _is_left(derivation: Derivation, name: str, partner: str) -> bool:
    """Whether the first of a pair is on the left: at positive y for a robot that looks along x."""
    if name == partner:
        return True
    skeleton = derivation.skeleton
    joints = {joint.name: joint for joint in skeleton.joints}
    # Facing y, the left is at negative x.
    normal = np.diag((np.eye(3) - derivation.reflection) / 2) * (-1 if derivation.plane == "yz" else 1)
    for what in ("anchor", "centre of mass"):
        one, other = (
            joints[n].get(what) if what == "anchor" else skeleton.bodies[joints[n].body].get(what)
            for n in (name, partner)
        )
        if abs(float(normal @ (one - other))) > 1e-6 * skeleton.size:
            return bool(normal @ (one - other) > 0)
    return True


def _groups(derivation: Derivation) -> dict[str, Sequence[Match]]:
    return {
        "body": derivation.bodies,
        "joint": derivation.joints,
        "geom": derivation.shapes,
        "site": derivation.sites,
        "actuator": derivation.actuators,
        "sensor": derivation.sensors,
    }


def _counts(derivation: Derivation) -> Iterator[str]:
    plural = {"body": "bodies"}
    parts = []
    for kind, matches in _groups(derivation).items():
        if not matches:
            continue
        central = sum(match.partner == match.name for match in matches)
        pairs = sum(match.partner not in (None, match.name) for match in matches) // 2
        parts.append(f"{plural.get(kind, kind + 's')}: {pairs} pairs, {central} central")
    yield "; ".join(parts)
    for kind, matches in (("actuator", derivation.actuators), ("sensor", derivation.sensors)):
        for match in matches:
            if match.partner is not None and match.name <= match.partner:
                sign = {1: "", -1: ", with opposite sign", 0: ""}[match.sign]
                other = "itself" if match.partner == match.name else f"'{match.partner}'"
                yield f"{kind} '{match.name}' mirrors into {other}{sign}"


def _complaints(derivation: Derivation) -> Iterator[str]:
    for kind, matches in _groups(derivation).items():
        for match in matches:
            if match.reason:
                yield f"NOT DERIVED: {kind} '{match.name}': {match.reason}"
    yield from (f"NOT COMPARED: {what}" for what in derivation.skeleton.left_out)
