"""Judges tables against a recording. No simulation: many tables can be tried on one recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor

from kickbench.audit.measure import (
    Measurement,
    contradiction,
    entry_contradiction,
    entry_name,
    entry_words,
    judge_misfits,
    measure,
)
from kickbench.audit.record import Pairs, Recording
from kickbench.audit.report import Row, Verdict, verdict_of
from kickbench.envs.compiled_task import CompiledTask
from kickbench.evaluation.rollouts import Policy
from kickbench.symmetry.derive import Derivation
from kickbench.symmetry.mirror import AXIAL, POLAR, Image, mirror_joints
from kickbench.symmetry.representation import Representation
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
_RESPONSE = 0.1
"""Relative; two actuators differ by about 1."""
_FORCE, _ODD_CONTACTS, _FEW = 1e-3, 1e-3, 20
"""Of forces, relative; share of steps in which a contact may be missed; least number of exact steps."""
_POLICY = 1e-4
"""Of a network that is equivariant by construction, in float32; relative to the largest output."""


def judge(recording: Recording, derivation: Derivation, symmetry: Symmetry, declared: Image) -> Iterator[Row]:
    """Judges tables by what was recorded: checks 1 to 5.

    Args:
        recording: States, their mirror images, and what became of both, of the robot with equal sides.
        derivation: What the robot's geometry says.
        symmetry: The declared tables.
        declared: The declared joint table.
    """
    yield from _table_rows(symmetry)
    yield from _declared_rows(derivation, declared)
    yield from _dynamics_rows(recording, declared, symmetry.actions)
    yield from _field_rows(recording, symmetry, declared)
    yield from term_rows(recording)
    yield from _sampling_rows(recording.task)


def _table_rows(symmetry: Symmetry) -> Iterator[Row]:
    """Check 1: every table squares to one and has the size of what it describes."""
    tables: dict[str, Representation] = {
        "positions": symmetry.qpos,
        "velocities": symmetry.qvel,
        **{f"{name} observations": table.representation for name, table in symmetry.groups.items()},
        "actions": symmetry.actions,
    }
    for name, representation in tables.items():
        matrix = representation.matrix()
        error = float(np.abs(matrix @ matrix - np.eye(representation.dim)).max(initial=0.0))
        verdict = verdict_of(wrong=error != 0.0)
        yield Row("tables", f"{name} [{representation.dim}]", verdict, error, 0.0, detail=str(representation))


def _declared_rows(derivation: Derivation, declared: Image) -> Iterator[Row]:
    """Check 1: the declared image of every joint is the one that follows from the geometry."""
    wrong = False
    for name, measured in derivation.image.items():
        if (said := declared.get(name)) is not None and said != measured:
            detail = f"declared {entry_words(name, *said)}; measured: {entry_words(name, *measured)}"
            wrong = True
            yield Row("tables", name, "FAIL", np.inf, 0.0, detail=detail)
    for match in derivation.unclear:
        yield Row("tables", match.name, "not compared", detail=f"by geometry: {match.reason}")
    if not wrong:
        yield Row("tables", f"joints by geometry [{len(derivation.image)}]", "ok", 0.0, 0.0)


# Check 2: velocities a step later by joint, contacts by channel, and the effect of every actuator


def _dynamics_rows(recording: Recording, declared: Image, actions: Representation) -> Iterator[Row]:
    original, image = recording.velocity.original, recording.velocity.image
    scale = max(1.0, float(np.abs(original).max(initial=0.0)))
    truth = recording.reflection.qvel.representation
    exact = np.abs(_apply(truth, original) - image).max(axis=1) <= _EXACT * scale
    yield from _free_rows(recording, scale)
    yield from _joint_rows(recording, declared, exact, scale)
    yield from _speed_rows(recording)
    yield from _contact_rows(recording, exact)
    yield from _actuator_rows(recording, actions)


def _apply(representation: Representation, vectors: np.ndarray) -> np.ndarray:
    return vectors[..., list(representation.permutation)] * np.array(representation.signs)


def _free_rows(recording: Recording, scale: float) -> Iterator[Row]:
    original, image = recording.velocity.original, recording.velocity.image
    for coordinate in recording.task.scene.layout.coordinates:
        for first, signs, what, unit in ((0, POLAR, "velocity", "m/s"), (3, AXIAL, "turning", "rad/s")):
            if coordinate.free:
                place = slice(coordinate.qvel + first, coordinate.qvel + first + 3)
                off = np.abs(original[:, place] * np.array(signs) - image[:, place])
                yield _motion_row(f"{coordinate.name} {what}", off, scale, unit, original[:, place])


def _joint_rows(recording: Recording, declared: Image, exact: np.ndarray, scale: float) -> Iterator[Row]:
    scene = recording.task.scene
    joints = {c.name: c.qvel for c in scene.layout.coordinates if not c.free}
    names, places = list(joints), list(joints.values())
    table = mirror_joints(names, {**declared, **scene.layout.scene_image})
    mine, theirs = recording.velocity.original[:, places], recording.velocity.image[:, places]
    off = np.abs(_apply(table, mine) - theirs)
    found = measure(mine[exact], theirs[exact], table, _EXACT, _EXACT) if exact.any() else None
    for orbit in table.orbits():
        columns, name = list(orbit), ", ".join(names[i] for i in orbit)
        unit = _speed_unit(recording, places[orbit[0]])
        row = _motion_row(name, off[:, columns], scale, unit, mine[:, columns])
        if row.failed and found is not None and found.measured is not None and found.wrong[columns].any():
            wrong = next(i for i in orbit if found.wrong[i])
            row = replace(row, detail=entry_contradiction(table, found.measured, wrong, names))
        yield row


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


def _actuator_rows(recording: Recording, actions: Representation) -> Iterator[Row]:
    """The effect of an actuator, mirrored, is the effect of its partner."""
    names = recording.task.scene.layout.actuator_names
    effects = _apply(recording.reflection.qvel.representation, recording.response.original)
    images = recording.response.image
    size = np.median(np.abs(effects).max(axis=2), axis=0)
    misfit = np.zeros((len(names), len(names), 2))
    for i in range(len(names)):
        # The median over the states: in one of them a joint may stand at its limit.
        off = np.median(np.abs(images - effects[:, i : i + 1]).max(axis=2), axis=0) / max(size[i], 1e-12)
        misfit[i] = off.reshape(2, -1).T
    found = judge_misfits(misfit, actions, _RESPONSE, 1.0)
    for orbit in actions.orbits():
        columns, name = list(orbit), ", ".join(names[i] for i in orbit)
        error, moved, detail = float(found.error[columns].max()), float(size[columns].min()), ""
        if wrong := [i for i in orbit if found.wrong[i]]:
            known = found.measured
            seen = "no actuator" if known is None else entry_name(known, wrong[0], names)
            detail = f"{names[wrong[0]]} declared {entry_name(actions, wrong[0], names)}; measured: {seen}"
        verdict = verdict_of(wrong=bool(wrong), excited=moved > 0.0)
        excited = f"moves by {moved:.2g} /s"
        yield Row("dynamics", f"action {name}", verdict, error, _RESPONSE, "", excited, detail)


# Checks 3 and 4: the values of terms in a state and in its mirror image


def _field_rows(recording: Recording, symmetry: Symmetry, declared: Image) -> Iterator[Row]:
    """Check 3: every observation field of a state's mirror image is rho times that of the state."""
    layout = recording.task.scene.layout
    components = {"joints": layout.joint_names, "actions": layout.actuator_names}
    own = {"joints": mirror_joints(layout.joint_names, declared), "actions": symmetry.actions}
    repeated = [pairs.name for pairs in recording.fields]
    for pairs in recording.fields:
        several = repeated.count(pairs.name) > 1
        name = f"{pairs.name} ({' and '.join(pairs.groups)})" if several else pairs.name
        representation = symmetry.groups[pairs.groups[0]][pairs.name]
        peak = float(np.abs(pairs.original).max(initial=0.0))
        found = judge_misfits(pairs.misfit, representation, max(_FIELD * peak, 1e-7), peak)
        stated = pairs.bound.term.representation if pairs.bound is not None else None
        yield _field_row(name, pairs, found, own, components.get(str(stated)))


def _field_row(
    name: str,
    pairs: Pairs,
    found: Measurement,
    own: Mapping[str, Representation],
    parts: Sequence[str] | None,
) -> Row:
    size, proven = len(found.error), int(found.proven.sum())
    verdict: Verdict = "ok"
    detail = ""
    if found.wrong.any():
        verdict, detail = "FAIL", contradiction(found, own, parts)
    elif not proven:
        verdict, detail = "never excited", f"{'constant' if found.peak else 'zero'} in every state"
    elif proven < size:
        names = parts or ("xyz" if size == 3 else [str(i) for i in range(size)])
        verdict, detail = "partly excited", _idle(pairs.original, found, names)
    unit = _unit(pairs)
    excited = f"{proven}/{size}, peak {found.peak:.3g} {unit}".rstrip()
    error = float(found.error.max(initial=0.0))
    return Row("observations", name, verdict, error, found.tolerance, unit, excited, detail)


def _unit(pairs: Pairs) -> str:
    return "" if pairs.unit in ("1", "true/false") else pairs.unit


def _idle(original: np.ndarray, found: Measurement, names: Sequence[str]) -> str:
    """Names the components for which the states prove nothing."""
    zero = np.abs(original).max(axis=0) == 0.0
    groups = {
        "zero in every state": zero & ~found.proven,
        "not distinguished from others": ~zero & ~found.proven,
    }
    parts = [(what, [names[int(i)] for i in np.flatnonzero(mask)]) for what, mask in groups.items()]
    return "; ".join(f"{', '.join(which)} {what}" for what, which in parts if which)


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
    return Row("terms", f"{kind} {pairs.name}", verdict, error, tolerance, _unit(pairs), excited, detail)


def _sampling_rows(task: CompiledTask) -> Iterator[Row]:
    """Check 5: which sampling regions are their own mirror images, and what the others' are."""
    sampling = task.spec.sampling
    target = sampling.target
    lateral = {"ball y": (sampling.ball.y, "m")}
    lateral |= {"target y": (target.y, "m")} if target.y else {"target angle": (target.polar()[1], "rad")}
    if sampling.ball.speed is not None:
        lateral["ball direction"] = (sampling.ball.direction or (0.0, 0.0), "rad")
    for name, ((low, high), unit) in lateral.items():
        error = abs(low + high)
        detail = f"[{low:g}, {high:g}] {unit}"
        verdict: Verdict = "ok"
        if error > 1e-9:
            verdict = "by design"
            detail += f"; mirror image: [{-high or 0.0:g}, {-low or 0.0:g}] {unit}"
        yield Row("sampling", name, verdict, error, None, unit, detail=detail)


# Check 7


def policy_rows(
    recording: Recording, symmetry: Symmetry, run: Trial, policy: Policy, critic: MLPModel | None
) -> Iterator[Row]:
    """Check 7: how equivariant a policy's mean action and value are, on the states it visits among others.

    Args:
        recording: States.
        symmetry: The declared tables.
        run: What the policy was trained with.
        policy: The actor.
        critic: The value function, if there is one.
    """
    exact = run.method.spec.network.type == "equivariant"
    with torch.inference_mode():
        here, there = _outputs(recording, symmetry, "actor", policy)
        yield _policy_row("mean action", Mirror(symmetry.actions)(here), there, exact)
        if critic is None:
            yield Row("policy", "value", "not compared", detail="the run has no checkpoint with a critic")
        else:
            yield _policy_row("value", *_outputs(recording, symmetry, "critic", critic), exact)


def _outputs(recording: Recording, symmetry: Symmetry, group: str, model: Policy) -> tuple[Tensor, Tensor]:
    """Outputs for the observations of every state, and for their mirror images [N, ...]."""
    observed = recording.group(group)
    mirrored = Mirror(symmetry.groups[group].representation)(observed)
    here, there = (TensorDict({group: part}, batch_size=[len(part)]) for part in (observed, mirrored))
    return model(here), model(there)


def _policy_row(name: str, expected: Tensor, found: Tensor, exact: bool) -> Row:
    off = (expected - found).abs()
    error, peak = float(off.max()), float(expected.abs().max())
    tolerance = _POLICY * max(1.0, peak) if exact else None
    verdict = "measured" if tolerance is None else verdict_of(wrong=not error <= tolerance)
    size = float(expected.square().mean().sqrt())
    detail = f"mean {float(off.mean()):.2g}; root mean square of the output {size:.2g}"
    return Row("policy", name, verdict, error, tolerance, "", f"peak {peak:.3g}", detail)
