"""Checks 1 and 3 to 6: judges tables against a recording. No simulation: many tables can be tried on one recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kickbench.audit.measure import Measurement, contradiction, entry_name, judge_misfits, measure
from kickbench.audit.record import Pairs, Recording, components
from kickbench.audit.report import Row, Verdict
from kickbench.envs.compile import CompiledTask
from kickbench.symmetry.mirror import AXIAL, POLAR, Image, mirror_joints
from kickbench.symmetry.representation import Representation
from kickbench.trials.trial import Symmetry

_EXACT = 1e-6
"""Relative velocity error of a step that mirrors exactly."""
_SHARE, _MOST = 0.8, 0.99
"""Share of steps that must mirror exactly, and share that must do so within `_LOOSE`. MuJoCo finds contacts between
convex shapes by iteration, which is not mirror-symmetric to the last digit; where they press hard, that shows."""
_LOOSE = 1e-3
"""Relative velocity error."""
_FIELD, _REWARD = 1e-5, 1e-4
"""Relative tolerances in float32: of an entry, and of a sum whose order changes."""
_SLIDE = 2  # MuJoCo's mjJNT_SLIDE
_RESPONSE = 0.1
"""Relative; two actuators differ by about 1."""
_FORCE, _ODD_CONTACTS, _FEW = 1e-3, 1e-3, 20
"""Of forces, relative; share of steps in which a contact may be missed; least number of exact steps."""


def own_representations(
    task: CompiledTask, image: Image, actions: Representation
) -> dict[str, Representation]:
    """The robot's own representations, for naming."""
    return {"joints": mirror_joints(task.scene.layout.joint_names, image), "actions": actions}


def table_rows(symmetry: Symmetry) -> Iterator[Row]:
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
        verdict: Verdict = "ok" if error == 0.0 else "FAIL"
        yield Row("tables", f"{name} [{representation.dim}]", verdict, error, 0.0, detail=str(representation))


def dynamics_rows(recording: Recording, declared: Image, actions: Representation) -> Iterator[Row]:
    """Check 3: velocities a step later by joint, contacts by channel, and the effect of every actuator."""
    task = recording.task
    original, image = recording.velocity.original, recording.velocity.image
    truth = recording.reflection.qvel.representation
    scale = max(1.0, float(np.abs(original).max(initial=0.0)))
    off = np.abs(_apply(truth, original) - image).max(axis=1)
    exact = off <= _EXACT * scale
    yield from _free_rows(task, original, image, scale)
    yield from _joint_rows(task, declared, original, image, exact, scale)
    yield from _contact_rows(recording, exact)
    yield from _actuator_rows(recording, declared, actions)


def _apply(representation: Representation, vectors: np.ndarray) -> np.ndarray:
    return vectors[:, list(representation.permutation)] * np.array(representation.signs)


def _free_rows(task: CompiledTask, original: np.ndarray, image: np.ndarray, scale: float) -> Iterator[Row]:
    for coordinate in task.scene.layout.coordinates:
        if not coordinate.free:
            continue
        for first, signs, what, unit in ((0, POLAR, "velocity", "m/s"), (3, AXIAL, "turning", "rad/s")):
            place = slice(coordinate.qvel + first, coordinate.qvel + first + 3)
            off = np.abs(original[:, place] * np.array(signs) - image[:, place]).max(axis=1)
            peak = float(np.abs(original[:, place]).max(initial=0.0))
            yield _motion_row(f"{coordinate.name} {what}", off, scale, unit, peak)


def _joint_rows(
    task: CompiledTask,
    declared: Image,
    original: np.ndarray,
    image: np.ndarray,
    exact: np.ndarray,
    scale: float,
) -> Iterator[Row]:
    joints = [c for c in task.scene.layout.coordinates if not c.free]
    names, places = [c.name for c in joints], [c.qvel for c in joints]
    slides = set(slide_joints(task))
    table = mirror_joints(names, declared)
    mine, theirs = original[:, places], image[:, places]
    off = np.abs(_apply(table, mine) - theirs)
    found = measure(mine[exact], theirs[exact], table, _EXACT, _EXACT) if exact.any() else None
    for orbit in table.orbits():
        columns = list(orbit)
        name, peak = ", ".join(names[i] for i in orbit), float(np.abs(mine[:, columns]).max(initial=0.0))
        unit = "m/s" if names[orbit[0]] in slides else "rad/s"
        row = _motion_row(name, off[:, columns].max(axis=1), scale, unit, peak)
        if row.failed and found is not None and found.measured is not None and found.wrong[columns].any():
            i = next(i for i in orbit if found.wrong[i])
            said, seen = entry_name(table, i, names), entry_name(found.measured, i, names)
            row = replace(row, detail=f"{names[i]} declared {said}; measured: {seen}")
        yield row


def slide_joints(task: CompiledTask) -> Iterator[str]:
    """Names of the joints that slide."""
    model = task.scene.model
    for joint, coordinate in enumerate(task.scene.layout.coordinates):
        if model.jnt_type[joint] == _SLIDE:
            yield coordinate.name


def _motion_row(name: str, off: np.ndarray, scale: float, unit: str, peak: float) -> Row:
    """Judges all steps; the row has the error that 99 % of them keep within, or 80 % where that is what fails."""
    worst = float(off.max(initial=0.0))
    typical, error = (float(np.quantile(off, q)) if len(off) else 0.0 for q in (_SHARE, _MOST))
    tolerance, verdict = _LOOSE * scale, "ok"
    exact = 100.0 * float((off <= _EXACT * scale).mean()) if len(off) else 0.0
    detail = f"{exact:.1f} % of steps exact, worst {worst:.2g} {unit}"
    if typical > _EXACT * scale:
        error, tolerance, verdict = typical, _EXACT * scale, "FAIL"
        detail = f"only {detail}"
    elif error > tolerance:
        verdict = "FAIL"
    elif peak == 0.0:
        verdict = "never excited"
    return Row("dynamics", name, verdict, error, tolerance, unit, f"peak {peak:.2g} {unit}", detail)


def _contact_rows(recording: Recording, exact: np.ndarray) -> Iterator[Row]:
    """Contacts of the mirrored step, in the steps that mirror exactly."""
    few = int(exact.sum()) < _FEW
    channels = [(False, pairs) for pairs in recording.touches] + [(True, pairs) for pairs in recording.forces]
    for is_force, pairs in channels:
        name = f"{'force' if is_force else 'contact'} {pairs.name}"
        if few:
            yield Row("dynamics", name, "not compared", detail="too few steps mirror exactly")
            continue
        mine, theirs = pairs.original[exact], pairs.image[exact]
        off, peak = np.abs(mine - theirs), float(np.abs(mine).max(initial=0.0))
        if is_force:
            error, tolerance, unit, excited = float(off.max()), _FORCE * peak, "N", f"peak {peak:.3g} N"
        else:
            error, tolerance, unit = float(off.sum()), _ODD_CONTACTS * len(mine), "states"
            excited = f"{int(mine.sum())} states"
        verdict: Verdict = "FAIL" if error > tolerance else "ok" if peak else "never excited"
        yield Row("dynamics", name, verdict, error, tolerance, unit, excited)


def _actuator_rows(recording: Recording, declared: Image, actions: Representation) -> Iterator[Row]:
    """The effect of an actuator, mirrored, is the effect of its partner."""
    names = recording.task.scene.layout.actuator_names
    truth = recording.reflection.qvel.representation
    effects = recording.response.original[:, :, list(truth.permutation)] * np.array(truth.signs)
    images = recording.response.image
    size = np.median(np.abs(effects).max(axis=2), axis=0)
    misfit = np.zeros((len(names), len(names), 2))
    for i in range(len(names)):
        # The median over the states: in one of them a joint may stand at its limit.
        off = np.median(np.abs(images - effects[:, i : i + 1]).max(axis=2), axis=0) / max(size[i], 1e-12)
        misfit[i] = off.reshape(2, -1).T
    found = judge_misfits(misfit, actions, _RESPONSE, 1.0)
    for orbit in actions.orbits():
        columns = list(orbit)
        error, name = float(found.error[columns].max()), ", ".join(names[i] for i in orbit)
        moved = float(size[columns].min())
        wrong = [i for i in orbit if found.wrong[i]]
        detail = ""
        if wrong:
            seen = "no actuator"
            if found.measured is not None:
                seen = entry_name(found.measured, wrong[0], names)
            detail = f"{names[wrong[0]]} declared {entry_name(actions, wrong[0], names)}; measured: {seen}"
        verdict: Verdict = "FAIL" if wrong else "ok" if moved > 0.0 else "never excited"
        excited = f"moves by {moved:.2g} /s"
        yield Row("dynamics", f"action {name}", verdict, error, _RESPONSE, "", excited, detail)


def field_rows(recording: Recording, symmetry: Symmetry, own: Mapping[str, Representation]) -> Iterator[Row]:
    """Check 4: every observation field of a state's mirror image is rho times that of the state."""
    repeated = [pairs.name for pairs in recording.fields]
    for pairs in recording.fields:
        name = pairs.name
        if repeated.count(name) > 1:
            name = f"{name} ({' and '.join(pairs.groups)})"
        declared = symmetry.groups[pairs.groups[0]][pairs.name]
        peak = float(np.abs(pairs.original).max(initial=0.0))
        found = judge_misfits(pairs.misfit, declared, max(_FIELD * peak, 1e-7), peak)
        yield _field_row(name, pairs, found, own, components(recording.task, pairs))


def _field_row(
    name: str,
    pairs: Pairs,
    found: Measurement,
    own: Mapping[str, Representation],
    parts: Sequence[str] | None,
) -> Row:
    size, proven = len(found.error), int(found.proven.sum())
    names = parts or ("xyz" if size == 3 else [str(i) for i in range(size)])
    detail = ""
    verdict: Verdict = "ok"
    if found.wrong.any():
        verdict, detail = "FAIL", contradiction(found, own, parts)
    elif not proven:
        verdict = "never excited"
        detail = "constant in every state" if found.peak else "zero in every state"
    elif proven < size:
        verdict, detail = "partly excited", _idle(pairs.original, found, names)
    unit = "" if pairs.unit in ("1", "true/false") else pairs.unit
    return Row(
        "observations",
        name,
        verdict,
        float(found.error.max(initial=0.0)),
        found.tolerance,
        unit,
        f"{proven}/{size}, peak {found.peak:.3g} {unit}".rstrip(),
        detail,
    )


def _idle(original: np.ndarray, found: Measurement, names: Sequence[str]) -> str:
    """Words which components prove nothing."""
    zero = np.abs(original).max(axis=0) == 0.0
    groups = {"zero in every state": zero & ~found.proven, "not told from others": ~zero & ~found.proven}
    parts = [(what, [names[int(i)] for i in np.flatnonzero(mask)]) for what, mask in groups.items()]
    return "; ".join(f"{', '.join(which)} {what}" for what, which in parts if which)


def term_rows(recording: Recording) -> Iterator[Row]:
    """Check 5: rewards and terminations are the same in the mirror."""
    for kind, group in (("reward", recording.rewards), ("termination", recording.terminations)):
        for pairs in group:
            mine, theirs = pairs.original, pairs.image
            error, peak = float(np.abs(mine - theirs).max(initial=0.0)), float(np.abs(mine).max(initial=0.0))
            tolerance = 0.0 if kind == "termination" else _REWARD * max(peak, _REWARD)
            share = float((mine != 0.0).mean())
            detail = ""
            verdict: Verdict = "ok"
            # NaN compares false, and is no agreement.
            if not error <= tolerance:
                verdict = "FAIL"
                odd = int((~(np.abs(mine - theirs) <= tolerance)).sum())
                detail = f"declared invariant; measured: changes by up to {error:.2g} ({odd} of {len(mine)} states)"
            elif peak == 0.0:
                verdict, detail = "never excited", "zero in every state"
            excited = f"in {int(share * len(mine) + 0.5)} states"
            unit = "" if pairs.unit in ("1", "true/false") else pairs.unit
            yield Row("terms", f"{kind} {pairs.name}", verdict, error, tolerance, unit, excited, detail)


def sampling_rows(task: CompiledTask) -> Iterator[Row]:
    """Check 6: which sampling regions are their own mirror images, and what the others' are."""
    sampling = task.spec.sampling
    lateral = {
        "ball y": (sampling.ball.y, "m"),
        "target angle": (sampling.target.angle, "rad"),
    }
    for name, ((low, high), unit) in lateral.items():
        error = abs(low + high)
        detail = f"[{low:g}, {high:g}] {unit}"
        verdict: Verdict = "ok"
        if error > 1e-9:
            verdict = "by design"
            detail += f"; mirror image: [{-high or 0.0:g}, {-low or 0.0:g}] {unit}"
        yield Row("sampling", name, verdict, error, None, unit, detail=detail)
