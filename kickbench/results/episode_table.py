"""The per-episode table of an evaluation, and the one CSV file that holds its two sides.

Row i is the episode from initial state i. Positions are horizontal, in metres, in the robot's frame at the
start of the episode: x forward, y left. Floats are finite but for those of the launch: an episode whose state
diverged is given its last finite ball position.

| column | content |
|---|---|
| `start_ball_x`, `start_ball_y` | ball at the start [m]; y >= 0 is the robot's left side |
| `target_x`, `target_y` | target [m] |
| `final_ball_x`, `final_ball_y` | ball at the end [m] |
| `distance` | from the ball to the target at the end, horizontal [m] |
| `success` | whether the task was solved |
| `termination` | name of the termination that ended the episode, or `NON_FINITE` |
| `steps` | control steps that the episode lasted |
| `episode_return` | undiscounted sum of rewards |
| `kick_foot` | what touched the ball first: left, right, other (not a foot) or none |
| `kick_step` | control step of that first touch, -1 if none |
| `peak_ball_speed` | highest horizontal speed of the ball [m/s] |
| `touches` | separate touches of the ball: control steps with contact after one without |
| `walked_after_touch` | how far the robot's base moved towards the ball after its first touch [m] |
| `launch_speed` | horizontal speed of the ball as it was first kicked [m/s]; NaN if it was never touched |
| `direction_error` | angle from the target to the ball's velocity at the launch, positive to the left [rad] |

The last four are defined in `kickbench.evaluation.probes`; tables of older versions lack them. The direction
is NaN if the ball was not faster then than the task's stop speed.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NamedTuple, get_args

import pandas as pd
from numpy.typing import ArrayLike

from kickbench.config.experiment import Side
from kickbench.errors import KickbenchError
from kickbench.results.atomic import atomic_write_text, read_text

NON_FINITE = "non_finite"
"""What ended an episode whose state became NaN or infinite, in the place of a termination's name."""
_KINDS: dict[str, Any] = {
    **dict.fromkeys(("start_ball_x", "start_ball_y", "target_x", "target_y"), float),
    **dict.fromkeys(("final_ball_x", "final_ball_y", "distance"), float),
    **{"success": bool, "termination": str, "steps": int, "episode_return": float},
    **{"kick_foot": str, "kick_step": int, "peak_ball_speed": float},
    **{"touches": int, "walked_after_touch": float, "launch_speed": float, "direction_error": float},
}
SIDES: tuple[Side, ...] = get_args(Side)
_DECIMALS = 6

EpisodeTable = pd.DataFrame
"""A table with the columns that the module describes."""


class EpisodeSides(NamedTuple):
    """The episodes of one evaluation: as the task samples them, and from the mirrored starts (or None)."""

    in_distribution: EpisodeTable
    mirrored: EpisodeTable | None = None


def episode_table(**columns: ArrayLike) -> EpisodeTable:
    """A table of episodes, its columns in the order of the file.

    Args:
        columns: by name [episodes].

    Raises:
        ValueError: a column is missing, or holds something else than its kind.
    """
    if missing := set(_KINDS) - set(columns):
        raise ValueError(
            f"expected the columns {', '.join(_KINDS)}; there is no {', '.join(sorted(missing))}"
        )
    return pd.DataFrame({name: columns[name] for name in _KINDS}).astype(_KINDS)


def write_episodes(path: Path, sides: EpisodeSides) -> None:
    """Write both sides to one CSV file, atomically.

    The first column, `side`, is `in_distribution` or `mirrored`; the others are those of the table. Floats
    have six decimals (a micrometre), truth values are 0 or 1: equal tables give equal bytes.

    Args:
        path: the file; `.gz` is compressed.
        sides: the episodes.
    """
    both = {side: table for side, table in zip(SIDES, sides, strict=True) if table is not None}
    whole = pd.concat(both, names=["side"]).reset_index("side").astype({"success": int})
    # Adding zero turns the -0.0 that rounding leaves into 0.0.
    floats = whole.select_dtypes("float")
    whole[floats.columns] = floats.round(_DECIMALS) + 0.0
    atomic_write_text(path, whole.to_csv(index=False, float_format=f"%.{_DECIMALS}f", na_rep="nan"))


def read_episodes(path: Path) -> EpisodeSides:
    """Read what `write_episodes` wrote.

    Args:
        path: the file.

    Returns:
        Both sides; `mirrored` is None if the file has no mirrored episode.

    Raises:
        KickbenchError: the file is missing or is no episode table.
    """
    try:
        text = io.StringIO(read_text(path))
        whole = pd.read_csv(text, dtype=str, keep_default_na=False)  # pandas' own numbers are not exact
        whole["success"] = whole["success"].astype(int)
        home, mirrored = (episode_table(**whole[whole["side"] == side]) for side in SIDES)
    except (OSError, ValueError, KeyError) as error:
        raise KickbenchError(f"{path}: cannot read the episode table: {error}") from error
    home, mirrored = home.reset_index(drop=True), mirrored.reset_index(drop=True)
    return EpisodeSides(home, mirrored if len(mirrored) else None)
