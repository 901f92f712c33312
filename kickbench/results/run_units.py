"""How the figure of a claim is written for people: percent, points, metres, plain numbers."""

from __future__ import annotations

from dataclasses import dataclass

from kickbench.config.experiment import (
    AnyClaim,
    AtLeast,
    AtMost,
    Metric,
    NearReported,
    RatioAtLeast,
    RatioAtMost,
)
from kickbench.results.statistics import Interval


@dataclass(frozen=True)
class Unit:
    """A unit and how many digits it is worth.

    Attributes:
        name: What follows a figure.
        factor: What a figure is multiplied by.
        decimals: Digits after the point.
        is_share: Whether the figure is a share from 0 to 1.
    """

    name: str
    factor: float
    decimals: int
    is_share: bool = False

    def write(self, value: float, interval: Interval | None = None) -> str:
        """A figure with its unit, and its interval if there is one."""
        name = f" {self.name}" if self.name else ""
        if interval is None:
            return f"{self._number(value)}{name}"
        return f"{self._number(value)} [{self._number(interval.low)}, {self._number(interval.high)}]{name}"

    def _number(self, value: float) -> str:
        return f"{self.factor * value:z.{self.decimals}f}"


_PERCENT = Unit("%", 100.0, 1, is_share=True)
_UNITS: dict[Metric, Unit] = {
    "success_rate": _PERCENT,
    "mean_distance": Unit("m", 1.0, 3),
    "median_distance": Unit("m", 1.0, 3),
    "kicked_fraction": _PERCENT,
    "mean_episode_steps": Unit("steps", 1.0, 1),
    "termination_share": _PERCENT,
    "same_side_share": _PERCENT,
    "favourite_foot_share": _PERCENT,
    "equivariance_error": Unit("%", 100.0, 2),
    "pair_agreement": _PERCENT,
    "return_length_correlation": Unit("", 1.0, 3),
    "raw_reward": Unit("a step", 1.0, 4),
    "touches": Unit("touches", 1.0, 2),
    "walked_after_touch": Unit("m", 1.0, 3),
    "steps_to_kick": Unit("M steps", 1e-6, 2),
    "steps_to_half_success": Unit("M steps", 1e-6, 2),
    "success_area": _PERCENT,
    "return_trough": Unit("", 1.0, 2),
}
_POINTS = Unit("points", 100.0, 1)
_RATIO = Unit("", 1.0, 2)


def unit_of(claim: AnyClaim) -> Unit:
    """The unit of what a claim compares with its bound."""
    if isinstance(claim, RatioAtMost | RatioAtLeast):
        return _RATIO
    unit = _UNITS[claim.metric]
    single = isinstance(claim, AtLeast | AtMost | NearReported)
    return unit if single or not unit.is_share else _POINTS
