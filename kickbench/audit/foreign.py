"""Proves a mirror function that somebody wrote by hand, in the form of rsl_rl's symmetry extension."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from kickbench.errors import KickbenchError
from kickbench.sim.twins import Twins, read_twins
from kickbench.symmetry.mirror import AXIAL, POLAR

_STATES = 64
_TOLERANCE = 1e-4
"""Of float32 numbers, relative to a channel's largest."""
_SLACK = 0.03
"""Share of states in which a channel may differ: MuJoCo's contacts do not mirror to the last digit."""
_MOTION = 1e-4
Arrays = dict[str, np.ndarray]
"""Observations by group, [N, width] each."""
FIELDS: Mapping[str, tuple[int, ...]] = {
    "base_lin_vel": POLAR,
    "base_ang_vel": AXIAL,
    "projected_gravity": POLAR,
    "base_height": (1,),
    "velocity_commands": (1, -1, -1),
    "clock": (-1, -1),
}
"""Observations of one body, by the signs of their components. `velocity_commands` are x, y and yaw
rate; `clock` is sine and cosine of a gait whose mirror image is half a period later."""


@dataclass(frozen=True)
class Expected:
    """What a mirror should make of a vector: `factor * x[source] + offset`, by channel.

    Attributes:
        names: Names of the channels.
        source: Channel that each is read from; -1: not known.
        factor: Factor; of pairs with one scale +1 or -1.
        offset: What an asymmetric default pose adds.
        turn: Whether the channel is a phase in [0, 1), where 1 is 0.
    """

    names: list[str] = field(default_factory=list)
    source: list[int] = field(default_factory=list)
    factor: list[float] = field(default_factory=list)
    offset: list[float] = field(default_factory=list)
    turn: list[bool] = field(default_factory=list)

    def add(
        self, name: str, source: int, factor: float = 1.0, offset: float = 0.0, turn: bool = False
    ) -> None:
        """Adds a channel."""
        for column, value in zip(vars(self).values(), (name, source, factor, offset, turn), strict=True):
            column.append(value)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Mirror image of x [N, d]; NaN where it is not known."""
        y = x[:, self.source] * np.array(self.factor) + np.array(self.offset)
        y = np.where(self.turn, y % 1.0, y)
        return np.where(np.array(self.source) < 0, np.nan, y)


@dataclass(frozen=True)
class View:
    """A vector in every state, and what it should be in the mirror image.

    Attributes:
        names: Names of the channels.
        source: In the states [N, d].
        image: In their images [N, d]; NaN where it is not known.
        turn: Channels that are phases [d] bool.
    """

    names: list[str]
    source: np.ndarray
    image: np.ndarray
    turn: Any = False

    @property
    def known(self) -> np.ndarray:
        """Channels that are compared [d] bool."""
        return np.logical_not(np.isnan(self.image).all(axis=0))

    def judge(self, given: np.ndarray) -> Iterator[str]:
        """What is wrong with a mirror's images [N, d], a line a channel."""
        off = given - self.image
        off = np.abs(np.where(self.turn, (off + 0.5) % 1.0 - 0.5, off))
        tolerance = _TOLERANCE * np.maximum(1e-2, np.abs(self.source).max(axis=0, initial=0.0))
        wrong = ~(off <= tolerance) & ~np.isnan(self.image)
        for i in np.flatnonzero(wrong.mean(axis=0) > _SLACK):
            count = int(wrong[:, i].sum())
            where = "" if count == _STATES else f" in {count} of {_STATES} rows"
            rows = wrong[:, i]
            yield (
                f"{self.names[i]}: the mirror gives {self._words(given[rows, i], rows)}{where}; "
                f"right: {self._words(self.image[:, i], slice(None))}"
            )

    def _words(self, y: np.ndarray, rows: Any) -> str:
        """A channel's values by the channel that they are read from: "-policy[3] + 0.03"."""
        if np.ptp(y) < 1e-9:
            return f"{y[0]:.3g} in every state"
        found = _affine(self.source[rows], y) if len(y) > 3 else None
        if found is None:
            return "no multiple of one channel"
        column, factor, offset = found
        size = "" if abs(factor) == 1.0 else f"{abs(factor):.4g} x "
        shift = f" {'-' if offset < 0 else '+'} {abs(offset):.3g}" if abs(offset) > 2e-4 else ""
        return f"{'-' if factor < 0 else ''}{size}{self.names[column]}{shift}"


@dataclass(frozen=True)
class MirrorReport:
    """What was found; false if the mirror is wrong.

    Attributes:
        findings: What is wrong, a line each: the channel, what the mirror gives and what would be right.
        notes: What was not checked, and why.
        checked: Number of channels that were compared.
    """

    findings: tuple[str, ...]
    notes: tuple[str, ...]
    checked: int

    def __bool__(self) -> bool:
        return not self.findings

    def __str__(self) -> str:
        verdict = f"WRONG: {self.findings[0]}" if self.findings else f"right in all {self.checked} channels"
        return "\n".join(
            [*self.findings, *(f"not checked: {note}" for note in self.notes), f"mirror: {verdict}"]
        )


def check_mirror(
    model: str | Path,
    mirror: Callable[..., Any],
    observe: Callable[..., Any] | None = None,
    fields: Sequence[str] = (),
    *,
    group: str = "policy",
    period: float | None = None,
    env: Any = None,
) -> MirrorReport:
    """Checks a hand-written mirror function against a robot's geometry and physics.

    The robot's sides are made equal first, so that real hardware's tolerances do not blur the answer.

    Args:
        model: MJCF, whose actions are its controls, or a `robot.yaml`, whose actions are offsets from its
            pose.
        mirror: `(env, obs, actions) -> (obs, actions)`: originals, then mirror images, as rsl_rl calls it;
            obs is a TensorDict, or a tensor [N, width] for a function that takes one.
        observe: `(model, data)` -> observation vector, or a dict of vectors by group.
        fields: Without `observe`: what the vector of `group` is made of; names of `FIELDS`, `joint_pos`
            (minus the default pose), `joint_angles`, `joint_vel`, `actions`, `feet` (left, right), `phase`
            (in [0, 1)), or `NAME:WIDTH` for what cannot be checked.
        group: Name of the group where there is only one.
        period: Period of clocks that `observe` reads off `data.time`, s.
        env: What the mirror gets as its environment.

    Raises:
        KickbenchError: The model cannot be read, or the functions do not have these forms.
    """
    twins, notes = read_twins(Path(model)), []
    actions = np.random.default_rng(0).normal(size=(_STATES, twins.model.nu)).astype(np.float32)
    law = _action_law(twins, notes)
    wanted = law(actions)
    views = {"actions": View(law.names, actions, wanted)}
    if observe is not None:
        views |= _observed(twins, observe, group, actions, wanted, period, notes)
    elif fields:
        views |= _described(twins, fields, group, law, notes)
    given = _call(mirror, env, {name: view.source for name, view in views.items()})
    findings = _shape_faults(views, given)
    if not findings:
        copies = range(_STATES, len(given["actions"]), _STATES)
        images = [{name: given[name][k : k + _STATES] for name in views} for k in copies]
        # Of several images, that which is most nearly the reflection.
        findings, image = min(
            (([line for n, view in views.items() for line in view.judge(part[n])], part) for part in images),
            key=lambda found: len(found[0]),
        )
        findings = findings or _motion(twins, actions, image["actions"])
    return MirrorReport(tuple(findings), tuple(notes), sum(int(view.known.sum()) for view in views.values()))


def _action_law(twins: Twins, notes: list[str]) -> Expected:
    """How actions mirror: the images of the controls, through the default targets and scales."""
    law, command = Expected(), twins.command
    places = {match.name: i for i, match in enumerate(twins.derivation.actuators)}
    for i, match in enumerate(twins.derivation.actuators):
        if match.partner is None:
            notes.append(f"action {match.name}: {match.reason}")
            law.add(match.name, -1)
        else:
            j = places[match.partner]
            offset = (match.sign * command.default[j] - command.default[i]) / command.scale[i]
            law.add(match.name, j, match.sign * command.scale[j] / command.scale[i], offset)
    return law


def _described(
    twins: Twins, fields: Sequence[str], group: str, actions: Expected, notes: list[str]
) -> dict[str, View]:
    """A vector of random numbers, and its mirror image by what its fields are."""
    law = Expected()
    for text in fields:
        name, _, width = text.partition(":")
        first, joints = len(law.names), list(twins.joints)
        if name in FIELDS:
            for k, sign in enumerate(FIELDS[name]):
                law.add(f"{name}[{k}]", first + k, sign)
        elif name in ("joint_pos", "joint_angles", "joint_vel"):
            for joint in joints:
                if joint not in twins.derivation.image:
                    law.add(f"{name} {joint}", -1)
                    notes.append(f"{name} {joint}: its mirror image does not follow from the geometry")
                    continue
                partner, sign = twins.derivation.image[joint]
                mine, theirs = (twins.pose[twins.joints[j].qpos] for j in (joint, partner))
                offset = sign * theirs - mine if name == "joint_pos" else 0.0
                law.add(f"{name} {joint}", first + joints.index(partner), sign, offset)
        elif name == "actions":
            for channel, source, factor, offset, _ in zip(*vars(actions).values(), strict=True):
                law.add(f"{name} {channel}", first + source if source >= 0 else -1, factor, offset)
        elif name == "feet":
            law.add("feet left", first + 1)
            law.add("feet right", first)
        elif name == "phase":
            law.add("phase", first, 1.0, 0.5, True)
        elif width.isdecimal():
            notes.append(f"{name}: {width} channels")
            for k in range(int(width)):
                law.add(f"{name}[{k}]", -1)
        else:
            known = ", ".join([*FIELDS, "joint_pos", "joint_angles", "joint_vel", "actions", "feet", "phase"])
            raise KickbenchError(f"--fields: unknown field '{name}'; expected {known} or NAME:WIDTH")
    source = np.random.default_rng(1).uniform(0.0, 1.0, (_STATES, len(law.names))).astype(np.float32)
    return {group: View(law.names, source, law(source), np.array(law.turn))}


def _observed(
    twins: Twins,
    observe: Callable[..., Any],
    group: str,
    actions: np.ndarray,
    images: np.ndarray,
    period: float | None,
    notes: list[str],
) -> dict[str, View]:
    """Observations of physical states and of their mirror images."""
    rows: list[tuple[Arrays, ...]] = []
    states: list[np.ndarray] = []

    def vectors(data: Any) -> Arrays:
        seen = observe(twins.model, data)
        groups = seen if isinstance(seen, Mapping) else {group: seen}
        return {name: np.array(vector, dtype=np.float32).ravel() for name, vector in groups.items()}

    try:
        for original, image in twins.states(actions, np.nan_to_num(images), (period or 0.0) / 2.0):
            states.append(np.concatenate([original.qpos, original.qvel]))
            seen = vectors(original)
            original.time += 0.37
            rows.append((seen, vectors(image), vectors(original)))
    except (TypeError, ValueError, LookupError, AttributeError) as error:
        raise KickbenchError(f"observe: {type(error).__name__}: {error}") from None
    found, labels = {}, twins.labels
    for name in rows[0][0]:
        source, image, later = (np.stack([row[k][name] for row in rows]) for k in range(3))
        channels = [f"{name}[{i}]" for i in range(source.shape[1])]
        for i, channel in enumerate(channels):
            if period is None and (source[:, i] != later[:, i]).any():
                notes.append(f"{channel}: it depends on data.time; --period says how long a gait takes")
                image[:, i] = np.nan
            elif (same := _affine(np.stack(states), source[:, i])) and same[1] == 1.0:
                channels[i] = f"{channel} ({labels[same[0]]})"
        found[name] = View(channels, source, image)
    return found


# The mirror, and what comes back of it


def _call(mirror: Callable[..., Any], env: Any, batch: Arrays) -> Arrays:
    """Calls a mirror as rsl_rl does, with a TensorDict or, where it takes none, with a tensor."""
    try:
        known = inspect.signature(mirror).bind(env=env, obs=None, actions=None).signature.parameters
    except TypeError as error:
        raise KickbenchError(f"mirror: expected the signature (env, obs, actions): {error}") from None
    tensors = {name: torch.from_numpy(array.copy()) for name, array in batch.items()}
    actions = tensors.pop("actions")
    options: list[Any] = [TensorDict(tensors, batch_size=[_STATES])] if tensors else [None]
    if len(tensors) == 1:
        tensor = next(iter(tensors.values()))
        options = [tensor] if "obs_type" in known else [*options, tensor]
    extra = {"obs_type": next(iter(tensors), "policy")} if "obs_type" in known else {}
    reasons = []
    for obs in options:
        try:
            seen, acted = mirror(env=env, obs=obs, actions=actions.clone(), **extra)
            arrays = (
                {}
                if seen is None
                else seen
                if not isinstance(seen, torch.Tensor)
                else {next(iter(tensors)): seen}
            )
            return {
                name: array.detach().double().numpy() for name, array in [*arrays.items(), ("actions", acted)]
            }
        except Exception as error:  # it may raise anything
            reasons.append(" ".join(f"{type(error).__name__}: {error}".split())[:200])
    hint = (
        "" if tensors else "; without observations it gets obs=None: --observe or --fields says what they are"
    )
    raise KickbenchError(f"mirror: cannot be called: {' / '.join(dict.fromkeys(reasons))}{hint}")


def _shape_faults(views: Mapping[str, View], given: Arrays) -> list[str]:
    """What is wrong with the rows of an augmented batch: the originals come first, then whole copies."""
    rows = len(given["actions"])
    for name, view in views.items():
        shape, width = given[name].shape if name in given else None, view.source.shape[1]
        if shape != (rows, width) or rows % _STATES or rows < 2 * _STATES:
            return [f"{name}: expected shape ({2 * _STATES}, {width}), found {shape}"]
        if not np.array_equal(given[name][:_STATES], view.source):
            return [
                f"{name}: the first {_STATES} rows are not the originals, which come first, in their order"
            ]
    return []


def _motion(twins: Twins, actions: np.ndarray, images: np.ndarray) -> list[str]:
    """Steps states under actions, and their images under the mirror's."""
    if twins.derivation.unclear:
        return []
    errors = np.array([twins.motion_error(*pair) for pair in twins.states(actions, images, 0.0)])
    off = errors > _MOTION
    if off.mean() <= 0.2:
        return []
    return [f"dynamics: {off.sum()} of {_STATES} states move otherwise under mirrored actions"]


def _affine(source: np.ndarray, y: np.ndarray) -> tuple[int, float, float] | None:
    """Column, factor and offset with `y = factor * source[:, column] + offset`; None if no column fits."""
    x, z = source - source.mean(axis=0), y - y.mean()
    spread = (x**2).sum(axis=0)
    factor = np.divide(z @ x, spread, out=np.zeros_like(spread), where=spread > 1e-12)
    off = np.median(np.abs(z[:, None] - factor * x), axis=0)
    best = int(off.argmin())
    if z.std() < 1e-9 or off[best] > _TOLERANCE * max(1.0, np.abs(y).max()):
        return None
    factor = float(factor[best].round(4))
    return best, factor, float(np.median(y - factor * source[:, best]))
