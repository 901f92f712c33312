"""Judges tables against a recording. No simulation: many tables can be tried on one recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from tensordict import TensorDict

from kickbench.audit.findings import Row
from kickbench.audit.fit import Fit
from kickbench.audit.record import Pairs, Recording
from kickbench.evaluation.probes import EquivarianceProbe
from kickbench.evaluation.rollouts import Policy
from kickbench.symmetry.derive import Derivation
from kickbench.symmetry.mirror import Image
from kickbench.symmetry.representation import Representation, image_words
from kickbench.trials.trial import Symmetry, Trial

_EXACT, _LOOSE = 1e-6, 1e-3
"""Relative velocity errors of a step that mirrors exactly, and of any other. MuJoCo finds contacts between
convex shapes by iteration, which is not mirror-symmetric to the last digit; where they press hard, that
shows."""
_SHARE, _MOST = 0.8, 0.99
"""Share of steps that must mirror exactly, and share that must keep within the other error."""
_FIELD, _REWARD = 1e-5, 1e-4
"""Relative tolerances in float32: of an entry, and of a sum whose order changes."""
_FORCE, _CONTACTS, _FEW = 1e-3, 0.999, 20
"""Of forces, relative; share of steps whose contacts must agree; least number of exact steps."""
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
    yield from _field_rows(recording, symmetry)
    yield from term_rows(recording)


def _table_rows(
    recording: Recording, derivation: Derivation, actions: Representation, declared: Image
) -> Iterator[Row]:
    """Check 1: the declared image of every joint is the one that follows from the geometry.

    That of every action is the one used to mirror states, which check 2 proves.
    """
    names, proven = recording.task.scene.layout.actuator_names, recording.reflection.actions.representation
    said, seen = (
        {
            f"action {n}": (f"action {names[p]}", s)
            for n, p, s in zip(names, t.permutation, t.signs, strict=True)
        }
        for t in (actions, proven)
    )
    for what, mine, theirs in (("joints", declared, derivation.image), ("actions", said, seen)):
        wrong = {n: entry for n, entry in theirs.items() if mine.get(n, entry) != entry}
        for name, entry in wrong.items():
            detail = f"declared {image_words(name, *mine[name])}; measured: {image_words(name, *entry)}"
            yield Row("tables", name, "FAIL", np.inf, 0.0, detail=detail)
        if not wrong:
            yield Row("tables", f"{what} by geometry [{len(theirs)}]", "ok", 0.0, 0.0)
    for match in derivation.unclear:
        yield Row("tables", match.name, "not compared", detail=f"by geometry: {match.reason}")


def _compared(
    check: str, name: str, values: Sequence[np.ndarray] | np.ndarray, unit: str, *limits: tuple[float, float]
) -> Row:
    """Judges values that must be equal, those of a state [N, d] already reflected and those of its image.

    Every limit is a share of the states and the error that it keeps within; the row has the first that is
    broken, or the last.
    """
    mine, theirs = values
    off, peak, error, tolerance = np.abs(mine - theirs).max(axis=1), _peak(mine), 0.0, 0.0
    for share, tolerance in limits if len(off) else ():
        error = float(np.quantile(off, share, method="lower"))
        if not error <= tolerance:  # a comparison with NaN is false, so NaN counts as a violation
            odd = int((~(off <= tolerance)).sum())
            detail = (
                f"declared invariant; measured: changes by up to {off.max():.2g} ({odd} of {len(off)} states)"
            )
            return Row(check, name, "FAIL", error, tolerance, unit, detail=detail)
    excited = f"peak {peak:.2g} in {int(mine.any(axis=1).sum())} states"
    return Row(check, name, "ok" if peak else "never excited", error, tolerance, unit, excited)


def _peak(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0))


def _dynamics_rows(recording: Recording) -> Iterator[Row]:
    """Check 2: velocities a step later by joint; contacts by channel, in steps that mirror exactly."""
    mine, theirs = recording.of("velocity")[0].both
    scale = max(1.0, _peak(mine))
    limits = (_SHARE, _EXACT * scale), (_MOST, _LOOSE * scale)
    for name, columns in _moving_parts(recording).items():
        yield _compared("dynamics", name, (mine[:, columns], theirs[:, columns]), "m/s or rad/s", *limits)
    yield from _speed_rows(recording, np.abs(mine))
    exact = np.abs(mine - theirs).max(axis=1) <= _EXACT * scale
    for pairs in recording.of("contact", "force"):
        name, values = f"{pairs.kind} {pairs.name}", pairs.both[:, exact]
        limit = (1.0, _FORCE * _peak(values[0])) if pairs.kind == "force" else (_CONTACTS, 0.0)
        if exact.sum() < _FEW:
            yield Row("dynamics", name, "not compared", detail="too few steps mirror exactly")
        else:
            yield _compared("dynamics", name, values, pairs.unit, limit)


def _speed_rows(recording: Recording, reflected: np.ndarray) -> Iterator[Row]:
    """Joints that states take beyond their velocity limit; a fall may, and a policy should not."""
    partners = recording.reflection.qvel.representation.permutation
    for joint, (place, limit) in recording.task.velocity_limits.items():
        speed = reflected[:, partners[place]]
        if share := 100.0 * float((speed > limit).mean()):
            detail = f"beyond its limit of {limit:g} in {share:.2g} % of the states"
            yield Row("dynamics", f"speed {joint}", "measured", float(speed.max()), limit, detail=detail)


def _moving_parts(recording: Recording) -> dict[str, list[int]]:
    """Names of free joints, and of the other joints with their partners -> places in qvel."""
    coordinates, found = recording.task.scene.layout.coordinates, dict[str, list[int]]()
    names = {c.qvel + k: c.name for c in coordinates for k in range(6 if c.free else 1)}
    for orbit in recording.reflection.qvel.representation.orbits():
        found.setdefault(", ".join(names[place] for place in orbit), []).extend(orbit)
    return found


def _field_rows(recording: Recording, symmetry: Symmetry) -> Iterator[Row]:
    """Check 3: every observation field of a state's mirror image is rho times that of the state."""
    layout, fields = recording.task.scene.layout, recording.of("observation")
    known = {"joints": layout.joint_names, "actions": layout.actuator_names}
    for pairs in fields:
        several = sum(other.name == pairs.name for other in fields) > 1
        name = f"{pairs.name} ({' and '.join(pairs.groups)})" if several else pairs.name
        representation = symmetry.groups[pairs.groups[0]][pairs.name]
        numbers = "xyz" if representation.dim == 3 else [str(i) for i in range(representation.dim)]
        yield _field_row(name, pairs, representation, known.get(pairs.stated, numbers))


def _field_row(name: str, pairs: Pairs, representation: Representation, parts: Sequence[str]) -> Row:
    peak = _peak(pairs.both[0])
    found = Fit(pairs.misfit, representation, max(_FIELD * peak, 1e-7))
    idle = [parts[i] for i in np.flatnonzero(~found.proven).tolist()]
    verdict, detail = "ok", f"not excited: {', '.join(idle)}" if idle else ""
    if found.wrong.any():
        verdict, detail = "FAIL", found.contradictions(parts)
    elif idle:
        verdict = "partly excited" if found.proven.any() else "never excited"
    excited = f"{found.proven.sum()}/{representation.dim}, peak {peak:.3g} {pairs.unit}".rstrip()
    error = float(found.error.max(initial=0.0))
    return Row("observations", name, verdict, error, found.tolerance, pairs.unit, excited, detail)


def term_rows(recording: Recording) -> Iterator[Row]:
    """Check 4: rewards and terminations are the same in the mirror."""
    for pairs in recording.of("reward", "termination"):
        relative = _REWARD if pairs.kind == "reward" else 0.0
        limit = 1.0, relative * max(_peak(pairs.both[0]), _REWARD)
        yield _compared("terms", f"{pairs.kind} {pairs.name}", pairs.both, pairs.unit, limit)


def policy_rows(recording: Recording, symmetry: Symmetry, run: Trial, policy: Policy) -> Iterator[Row]:
    """Check 6: how equivariant a policy's mean action is, on the states it visits among others.

    Args:
        recording: States.
        symmetry: The declared tables, without what the run's method excludes: such inputs are held at zero,
            and such actions are left out.
        run: What the policy was trained with.
        policy: The actor.
    """
    actor, states = recording.group("actor"), recording.states
    probe = EquivarianceProbe(
        policy, {"actor": symmetry.groups["actor"].representation}, symmetry.actions, symmetry.excluded
    )
    with torch.inference_mode():
        observed = TensorDict({"actor": actor}, batch_size=[states])
        actions = policy(observed)
        probe(observed, actions, torch.zeros(states), torch.ones(states, dtype=torch.bool))
    found, peak = probe.result(), float(actions.abs().max())
    if found is None or found.states < states:
        yield Row("policy", "mean action", "FAIL", detail="NaN or infinite in some states")
        return
    exact = run.method.spec.network.type == "equivariant"
    tolerance = _POLICY * max(1.0, peak) if exact else None
    verdict = "measured" if tolerance is None else "ok" if found.largest <= tolerance else "FAIL"
    detail = f"root mean square {found.rms:.2g}, relative {found.relative:.2g}"
    yield Row("policy", "mean action", verdict, found.largest, tolerance, "", f"peak {peak:.3g}", detail)
