"""Judges tables against a recording. No simulation: many tables can be tried on one recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import torch
from tensordict import TensorDict

from kickbench.audit.findings import Row, Verdict, verdict_of
from kickbench.audit.fit import Measurement, contradiction, entry_contradiction, judge_misfits
from kickbench.audit.record import Pairs, Recording
from kickbench.evaluation.rollouts import Policy
from kickbench.symmetry.derive import Derivation
from kickbench.symmetry.mirror import Image, mirror_joints
from kickbench.symmetry.representation import Representation, image_words
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import Symmetry, Trial

_EXACT = 1e-6
"""Relative velocity error of a step that mirrors exactly."""
_SHARE, _MOST = 0.8, 0.99
"""Share of steps that must mirror exactly, and share that must do so within `_LOOSE`. MuJoCo finds contacts
between convex shapes by iteration, which is not mirror-symmetric to the last digit; where they press hard,
that shows."""
_LOOSE = 1e-3
"""Relative velocity error."""
_FIELD, _REWARD = 1e-5, 1e-4
"""Relative tolerances in float32: of an entry, and of a sum whose order changes."""
_SLIDE = 2  # MuJoCo's mjJNT_SLIDE
_FORCE, _ODD_CONTACTS, _FEW = 1e-3, 1e-3, 20
"""Of forces, relative; share of steps in which a contact may be missed; least number of exact steps."""
_POLICY = 1e-4
"""Of a network that is equivariant by construction, in float32; relative to the largest output."""


def judge(recording: Recording, derivation: Derivation, symmetry: Symmetry, declared: Image) -> Iterator[Row]:
    """Judges tables by what was recorded: checks 1 to 4.

    Args:
        recording: States, their mirror images, and what became of both.
        derivation: What the robot's geometry says.
        symmetry: The declared tables.
        declared: The declared joint table.
    """
    yield from _table_rows(recording, derivation, symmetry.actions, declared)
    yield from _dynamics_rows(recording)
    yield from _field_rows(recording, symmetry, declared)
    yield from term_rows(recording)


def _table_rows(
    recording: Recording, derivation: Derivation, actions: Representation, declared: Image
) -> Iterator[Row]:
    """Check 1: the declared image of every joint is the one that follows from the geometry.

    That of every action is the one used to mirror states, which check 2 proves.
    """
    joints = {
        name: f"declared {image_words(name, *declared[name])}; measured: {image_words(name, *measured)}"
        for name, measured in derivation.image.items()
        if declared.get(name, measured) != measured
    }
    proven, names = recording.reflection.actions.representation, recording.task.scene.layout.actuator_names
    entries = (zip(table.permutation, table.signs, strict=True) for table in (actions, proven))
    moved = {
        f"action {names[i]}": entry_contradiction(actions, proven, i, names)
        for i, (said, seen) in enumerate(zip(*entries, strict=True))
        if said != seen
    }
    tables = ("joints", derivation.image, joints, derivation.unclear), ("actions", names, moved, ())
    for what, parts, wrong, unclear in tables:
        for name, detail in wrong.items():
            yield Row("tables", name, "FAIL", np.inf, 0.0, detail=detail)
        for match in unclear:
            yield Row("tables", match.name, "not compared", detail=f"by geometry: {match.reason}")
        if not wrong:
            yield Row("tables", f"{what} by geometry [{len(parts)}]", "ok", 0.0, 0.0)


# Check 2: velocities a step later by joint, and contacts by channel


def _dynamics_rows(recording: Recording) -> Iterator[Row]:
    original, image = recording.velocity.original, recording.velocity.image
    off = np.abs(recording.reflection.qvel.representation.mirror(original) - image)
    scale = max(1.0, float(np.abs(original).max(initial=0.0)))
    for name, columns, unit in _moving_parts(recording):
        yield _motion_row(name, off[:, columns], scale, unit, original[:, columns])
    yield from _speed_rows(recording)
    yield from _contact_rows(recording, off.max(axis=1) <= _EXACT * scale)


def _moving_parts(recording: Recording) -> Iterator[tuple[str, list[int], str]]:
    """Names, places in qvel and units of free joints, and of the other joints with their partners."""
    joints = dict[int, str]()
    for coordinate in recording.task.scene.layout.coordinates:
        place = coordinate.qvel
        if coordinate.free:
            yield f"{coordinate.name} velocity", [*range(place, place + 3)], "m/s"
            yield f"{coordinate.name} turning", [*range(place + 3, place + 6)], "rad/s"
        else:
            joints[place] = coordinate.name
    for orbit in recording.reflection.qvel.representation.orbits():
        if orbit[0] in joints:
            yield ", ".join(joints[i] for i in orbit), [*orbit], _speed_unit(recording, orbit[0])


def _motion_row(name: str, errors: np.ndarray, scale: float, unit: str, moved: np.ndarray) -> Row:
    """Judges all steps; the row has the 99 % quantile of the errors, or the 80 % quantile if that fails."""
    off, peak = errors.max(axis=1), float(np.abs(moved).max(initial=0.0))
    typical, error = (float(np.quantile(off, q)) if len(off) else 0.0 for q in (_SHARE, _MOST))
    tolerance = _LOOSE * scale
    verdict = verdict_of(wrong=error > tolerance, excited=peak != 0.0)
    exact = 100.0 * float((off <= _EXACT * scale).mean()) if len(off) else 0.0
    detail = f"{exact:.1f} % of steps exact, worst {float(off.max(initial=0.0)):.2g} {unit}"
    if typical > _EXACT * scale:
        error, tolerance, verdict, detail = typical, _EXACT * scale, "FAIL", f"only {detail}"
    return Row("dynamics", name, verdict, error, tolerance, unit, f"peak {peak:.2g} {unit}", detail)


def _speed_rows(recording: Recording) -> Iterator[Row]:
    """Joints that states take beyond their velocity limit; a fall may, and a policy should not."""
    for joint, (place, limit) in recording.task.velocity_limits.items():
        speed = np.abs(recording.velocity.original[:, place])
        if share := float((speed > limit).mean()):
            unit, usual = _speed_unit(recording, place), float(np.quantile(speed, _MOST))
            detail = f"beyond its limit of {limit:g} {unit} in {100.0 * share:.2g} % of the states"
            excited = f"peak {speed.max():.2g} {unit}"
            yield Row("dynamics", f"speed {joint}", "measured", usual, limit, unit, excited, detail)


def _speed_unit(recording: Recording, place: int) -> str:
    model = recording.task.scene.model
    return "m/s" if model.jnt_type[model.dof_jntid[place]] == _SLIDE else "rad/s"


def _contact_rows(recording: Recording, exact: np.ndarray) -> Iterator[Row]:
    """Contacts of the mirrored step, in the steps that mirror exactly."""
    for pairs in (*recording.touches, *recording.forces):
        name = f"{'force' if pairs.unit else 'contact'} {pairs.name}"
        if exact.sum() < _FEW:
            yield Row("dynamics", name, "not compared", detail="too few steps mirror exactly")
            continue
        mine, theirs = pairs.original[exact], pairs.image[exact]
        off, peak = np.abs(mine - theirs), float(np.abs(mine).max(initial=0.0))
        if pairs.unit:
            error, tolerance, unit, excited = float(off.max()), _FORCE * peak, "N", f"peak {peak:.3g} N"
        else:
            error, tolerance, unit = float(off.sum()), _ODD_CONTACTS * len(mine), "states"
            excited = f"{int(mine.sum())} states"
        verdict = verdict_of(wrong=error > tolerance, excited=peak != 0.0)
        yield Row("dynamics", name, verdict, error, tolerance, unit, excited)


# Checks 3 and 4: the values of terms in a state and in its mirror image


def _field_rows(recording: Recording, symmetry: Symmetry, declared: Image) -> Iterator[Row]:
    """Check 3: every observation field of a state's mirror image is rho times that of the state."""
    layout = recording.task.scene.layout
    names = {"joints": layout.joint_names, "actions": layout.actuator_names}
    own = {"joints": mirror_joints(layout.joint_names, declared), "actions": symmetry.actions}
    repeated = [pairs.name for pairs in recording.fields]
    for pairs in recording.fields:
        several = repeated.count(pairs.name) > 1
        name = f"{pairs.name} ({' and '.join(pairs.groups)})" if several else pairs.name
        representation = symmetry.groups[pairs.groups[0]][pairs.name]
        peak = float(np.abs(pairs.original).max(initial=0.0))
        tolerance = max(_FIELD * peak, 1e-7)
        found = judge_misfits(pairs.misfit, representation, tolerance)
        stated = pairs.bound.term.representation if pairs.bound is not None else None
        verdict, detail = _field_verdict(pairs.original, found, own, names.get(str(stated)))
        excited = f"{found.proven.sum()}/{representation.dim}, peak {peak:.3g} {pairs.unit}".rstrip()
        error = float(found.error.max(initial=0.0))
        yield Row("observations", name, verdict, error, tolerance, pairs.unit, excited, detail)


def _field_verdict(
    original: np.ndarray,
    found: Measurement,
    own: Mapping[str, Representation],
    names: Sequence[str] | None,
) -> tuple[Verdict, str]:
    """The verdict on a field, and what is wrong, or which components the states prove nothing for."""
    moved, size = original.any(axis=0), found.declared.dim
    if found.wrong.any():
        return "FAIL", contradiction(found, own, names)
    if not found.proven.any():
        return "never excited", f"{'constant' if moved.any() else 'zero'} in every state"
    names = names or ("xyz" if size == 3 else [str(i) for i in range(size)])
    idle = {
        "zero in every state": ~moved & ~found.proven,
        "not distinguished from others": moved & ~found.proven,
    }
    parts = [(what, [names[i] for i in np.flatnonzero(mask).tolist()]) for what, mask in idle.items()]
    detail = "; ".join(f"{', '.join(which)} {what}" for what, which in parts if which)
    return ("partly excited" if detail else "ok"), detail


def term_rows(recording: Recording) -> Iterator[Row]:
    """Check 4: rewards and terminations are the same in the mirror."""
    yield from (_term_row("reward", pairs, _REWARD) for pairs in recording.rewards)
    yield from (_term_row("termination", pairs, 0.0) for pairs in recording.terminations)


def _term_row(kind: str, pairs: Pairs, relative: float) -> Row:
    mine, theirs = pairs.original, pairs.image
    off, peak = np.abs(mine - theirs), float(np.abs(mine).max(initial=0.0))
    error, tolerance = float(off.max(initial=0.0)), relative * max(peak, _REWARD)
    # A comparison with NaN is false, so NaN counts as a violation.
    verdict = verdict_of(wrong=not error <= tolerance, excited=peak != 0.0)
    odd = f"{int((~(off <= tolerance)).sum())} of {len(mine)} states"
    details = {
        "FAIL": f"declared invariant; measured: changes by up to {error:.2g} ({odd})",
        "never excited": "zero in every state",
    }
    excited, detail = f"in {int((mine != 0.0).sum())} states", details.get(verdict, "")
    return Row("terms", f"{kind} {pairs.name}", verdict, error, tolerance, pairs.unit, excited, detail)


# Check 6


def policy_rows(recording: Recording, symmetry: Symmetry, run: Trial, policy: Policy) -> Iterator[Row]:
    """Check 6: how equivariant a policy's mean action is, on the states it visits among others.

    Args:
        recording: States.
        symmetry: The declared tables, without what the run's method excludes: such inputs are held at zero,
            and such actions are left out.
        run: What the policy was trained with.
        policy: The actor.
    """
    with torch.inference_mode():
        mirror = Mirror(symmetry.groups["actor"].representation)
        observed = mirror.held(recording.group("actor"))
        parts = (observed, mirror(observed))
        here, found = (policy(TensorDict({"actor": o}, batch_size=[len(o)])) for o in parts)
    actions = Mirror(symmetry.actions)
    expected, found = actions.held(actions(here)), actions.held(found)
    off = (expected - found).abs()
    error, peak = float(off.max()), float(expected.abs().max())
    exact = run.method.spec.network.type == "equivariant"
    tolerance = _POLICY * max(1.0, peak) if exact else None
    verdict = "measured" if tolerance is None else verdict_of(wrong=not error <= tolerance)
    size = float(expected.square().mean().sqrt())
    detail = f"mean {float(off.mean()):.2g}; root mean square of the output {size:.2g}"
    yield Row("policy", "mean action", verdict, error, tolerance, "", f"peak {peak:.3g}", detail)
