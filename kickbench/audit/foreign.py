"""Proves a mirror function that somebody wrote by hand, in the form of rsl_rl's symmetry extension."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from kickbench.errors import KickbenchError
from kickbench.sim.twins import Twins, read_twins

_STATES = 64
_TOLERANCE = 1e-4
"""Of float32 numbers, relative to a channel's largest."""
_SLACK = 0.03
"""Share of states in which a channel may differ: MuJoCo's contacts do not mirror to the last digit."""
_MOTION, _ODD = 1e-4, 0.2
"""Relative velocity error of a step that mirrors, and share of steps that may not."""
Arrays = dict[str, np.ndarray]
"""Observations by group, [N, width] each."""


@dataclass(frozen=True)
class View:
    """A vector in every state, and what it should be in the mirror image.

    Attributes:
        names: Names of the channels.
        source: In the states [N, d].
        image: In their images [N, d]; NaN where it is not known.
    """

    names: list[str]
    source: np.ndarray
    image: np.ndarray

    def judge(self, given: np.ndarray) -> Iterator[str]:
        """What is wrong with a mirror's images [N, d], a line a channel."""
        tolerance = _TOLERANCE * np.maximum(1e-2, np.abs(self.source).max(axis=0, initial=0.0))
        wrong = ~(np.abs(given - self.image) <= tolerance) & ~np.isnan(self.image)
        for i in np.flatnonzero(wrong.mean(axis=0) > _SLACK):
            rows = wrong[:, i]
            where = "" if rows.all() else f" in {rows.sum()} of {_STATES} rows"
            found, right = self._words(given[rows, i], rows), self._words(self.image[:, i])
            yield f"{self.names[i]}: the mirror gives {found}{where}; right: {right}"

    def _words(self, y: np.ndarray, rows: Any = slice(None)) -> str:
        """A channel's values by the channel that they are read from: "-policy[3] + 0.03"."""
        if np.ptp(y) < 1e-9:
            return f"{y[0]:.3g} in every state"
        if len(y) <= 3 or (found := _affine(self.source[rows], y)) is None:
            return "no multiple of one channel"
        column, factor, offset = found
        size = "-" if factor == -1.0 else "" if factor == 1.0 else f"{factor:.4g} x "
        return f"{size}{self.names[column]}" + (f" {offset:+.3g}" if abs(offset) > 2e-4 else "")


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
    *,
    group: str = "policy",
    period: float | None = None,
    env: Any = None,
) -> MirrorReport:
    """Checks a hand-written mirror function against a robot's geometry and physics.

    States are compared with states of the robot's mirror image, so that real hardware's tolerances do not
    blur the answer.

    Args:
        model: MJCF, whose actions are its controls, or a `robot.yaml`, whose actions are offsets from its
            pose.
        mirror: `(env, obs, actions) -> (obs, actions)`: originals, then mirror images, as rsl_rl calls it;
            obs is a TensorDict, or a tensor [N, width] for a function that takes one.
        observe: `(model, data)` -> observation vector, or a dict of vectors by group; without it, the actions
            alone are checked.
        group: Name of the group where there is only one.
        period: Period of clocks that `observe` reads off `data.time`, s.
        env: What the mirror gets as its environment.

    Raises:
        KickbenchError: The model cannot be read, or the functions do not have these forms.
    """
    twins, notes = read_twins(Path(model)), list[str]()
    actions = np.random.default_rng(0).normal(size=(_STATES, twins.model.nu)).astype(np.float32)
    views = {"actions": _acted(twins, actions, notes)}
    if observe is not None:
        views |= _observed(twins, observe, group, views["actions"], period, notes)
    given = _call(mirror, env, {name: view.source for name, view in views.items()})
    if not (findings := _shape_faults(views, given)):
        copies = range(_STATES, len(given["actions"]), _STATES)
        images = [{name: given[name][k : k + _STATES] for name in views} for k in copies]
        wrong = [[line for name, view in views.items() for line in view.judge(im[name])] for im in images]
        # Of several images, that which is most nearly the reflection.
        best = min(range(len(images)), key=lambda k: len(wrong[k]))
        findings = wrong[best] or _motion(twins, actions, images[best]["actions"])
    checked = sum(int((~np.isnan(view.image)).any(axis=0).sum()) for view in views.values())
    return MirrorReport(tuple(findings), tuple(notes), checked)


def _acted(twins: Twins, actions: np.ndarray, notes: list[str]) -> View:
    """How actions mirror: the images of the controls, through the default targets and scales."""
    matches, images = twins.derivation.actuators, np.full(actions.shape, np.nan)
    names = [match.name for match in matches]
    notes += [f"action {match.name}: {match.reason}" for match in matches if match.partner is None]
    for i, match in enumerate(matches):
        if match.partner is not None:
            j = names.index(match.partner)
            control = match.sign * (twins.default[j] + twins.scale[j] * actions[:, j])
            images[:, i] = (control - twins.default[i]) / twins.scale[i]
    return View(names, actions, images)


def _observed(
    twins: Twins,
    observe: Callable[..., Any],
    group: str,
    actions: View,
    period: float | None,
    notes: list[str],
) -> dict[str, View]:
    """Observations of physical states and of their mirror images."""
    rows, states, found = list[tuple[Arrays, ...]](), list[np.ndarray](), dict[str, View]()

    def vectors(model: Any, data: Any) -> Arrays:
        seen = observe(model, data)
        groups = seen if isinstance(seen, Mapping) else {group: seen}
        return {name: np.array(vector, dtype=np.float32).ravel() for name, vector in groups.items()}

    try:
        pairs = twins.states(actions.source, np.nan_to_num(actions.image), (period or 0.0) / 2.0)
        for original, image in pairs:
            states.append(np.concatenate([original.qpos, original.qvel]))
            seen = vectors(twins.model, original)
            original.time += 0.37
            rows.append((seen, vectors(twins.image, image), vectors(twins.model, original)))
    except (TypeError, ValueError, LookupError, AttributeError) as error:
        raise KickbenchError(f"observe: {type(error).__name__}: {error}") from None
    for name in rows[0][0]:
        source, image, later = (np.stack([row[k][name] for row in rows]) for k in range(3))
        names = [_channel(f"{name}[{i}]", column, states, twins) for i, column in enumerate(source.T)]
        clocks = np.flatnonzero((source != later).any(axis=0) & (period is None)).tolist()
        notes += [f"{names[i]}: it depends on data.time; --period says how long a gait takes" for i in clocks]
        image[:, clocks] = np.nan
        found[name] = View(names, source, image)
    return found


def _channel(name: str, values: np.ndarray, states: list[np.ndarray], twins: Twins) -> str:
    """The name of an observation's channel, with the coordinate that it is but for an offset."""
    same = _affine(np.stack(states), values)
    return f"{name} ({twins.labels[same[0]]})" if same and same[1] == 1.0 else name


# The mirror, and what comes back of it


def _call(mirror: Callable[..., Any], env: Any, batch: Arrays) -> Arrays:
    """Calls a mirror as rsl_rl does, with a TensorDict or, where it takes none, with a tensor."""
    tensors = {name: torch.from_numpy(array.copy()) for name, array in batch.items()}
    actions, reasons = tensors.pop("actions"), list[str]()
    options: list[Any] = [TensorDict(tensors, batch_size=[_STATES])] if tensors else [None]
    for obs in (*options, *(tensors.values() if len(tensors) == 1 else ())):
        try:
            seen, acted = mirror(env=env, obs=obs, actions=actions.clone())
            found = {} if seen is None else seen
            if isinstance(seen, torch.Tensor):
                found = {next(iter(tensors)): seen}
            arrays = {**found, "actions": acted}
            return {name: array.detach().double().numpy() for name, array in arrays.items()}
        except Exception as error:  # it may raise anything
            reasons.append(" ".join(f"{type(error).__name__}: {error}".split())[:200])
    hint = "" if tensors else "; without observations it gets obs=None: --observe says what they are"
    called = "mirror: cannot be called as mirror(env=, obs=, actions=)"
    raise KickbenchError(f"{called}: {' / '.join(dict.fromkeys(reasons))}{hint}")


def _shape_faults(views: Mapping[str, View], given: Arrays) -> list[str]:
    """What is wrong with the rows of an augmented batch: the originals come first, then whole copies."""
    rows = len(given["actions"])
    for name, view in views.items():
        shape, width = given[name].shape if name in given else None, view.source.shape[1]
        if shape != (rows, width) or rows % _STATES or rows < 2 * _STATES:
            return [f"{name}: expected shape ({2 * _STATES}, {width}), found {shape}"]
        if not np.array_equal(given[name][:_STATES], view.source):
            return [f"{name}: expected the {_STATES} originals first, in their order"]
    return []


def _motion(twins: Twins, actions: np.ndarray, images: np.ndarray) -> list[str]:
    """Steps states under actions, and their images under the mirror's."""
    if twins.derivation.unclear:
        return []
    off = [twins.motion_error(*pair) > _MOTION for pair in twins.states(actions, images, 0.0)]
    what = f"dynamics: {sum(off)} of {_STATES} states move otherwise under mirrored actions"
    return [what] if np.mean(off) > _ODD else []


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
