"""What the learning curve of a run amounts to: when it begins, how much it costs, how far it falls back.

Curves are those of exploration, from `progress.csv`, smoothed by a moving mean over a fiftieth of the training.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SMOOTHED = 0.02
"""Share of the iterations that a smoothed value is the mean of."""
_FINAL = 0.1
"""Share of the iterations, the last ones, that the final success is the mean of."""
KICKING = 0.05
"""Success rate in exploration from which on a policy counts as kicking."""

Curve = NDArray[np.float64]


def smoothed(curve: Curve) -> Curve:
    """Moving mean over the last iterations up to each one [n]; NaN, where an iteration knows nothing, is left out."""
    window = max(1, round(_SMOOTHED * len(curve)))
    known = np.isfinite(curve)
    sums, counts = (
        np.cumsum(np.concatenate([np.zeros(window), v])) for v in (np.where(known, curve, 0.0), known)
    )
    total, count = sums[window:] - sums[:-window], counts[window:] - counts[:-window]
    return np.divide(total, count, out=np.full(len(curve), np.nan), where=count > 0)


def steps_to_kick(success: Curve, steps: Curve) -> float | None:
    """Control steps until the smoothed success rate reaches `KICKING`; None if it never does.

    Args:
        success: Success rate of each iteration [n]; NaN where no episode ended.
        steps: Control steps done after each [n].
    """
    return _steps_until(success, steps, KICKING)


def steps_to_half_success(success: Curve, steps: Curve) -> float | None:
    """Control steps until the smoothed success rate reaches half of the final one, the mean of the last tenth."""
    last = success[-max(1, round(_FINAL * len(success))) :]
    final = float(np.nanmean(last)) if np.isfinite(last).any() else 0.0
    return _steps_until(success, steps, final / 2) if final > 0 else None


def success_area(success: Curve, _: Curve) -> float | None:
    """Area under the success rate over control steps, divided by all steps: its mean, a share."""
    return float(np.nanmean(success)) if np.isfinite(success).any() else None


def return_trough(returns: Curve, _: Curve) -> float | None:
    """Deepest fall of the smoothed return below its highest value so far, over the range of its values.

    With r the smoothed return and M_t = max(r_0, ..., r_t): max_t (M_t - r_t) / (max r - min r). 0 for a return that
    only rises, 1 for one that loses all it had.
    """
    known = smoothed(returns)
    known = known[np.isfinite(known)]
    spread = float(np.ptp(known)) if known.size else 0.0
    return float((np.maximum.accumulate(known) - known).max()) / spread if spread else None


def _steps_until(success: Curve, steps: Curve, level: float) -> float | None:
    reached = np.flatnonzero(smoothed(success) >= level)
    return float(steps[reached[0]]) if len(reached) else None
