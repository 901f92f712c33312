"""Randomisation of episode starts (thesis 3.1). Each is `(starts, params, draw) -> starts`."""

from __future__ import annotations

from kickbench.mdp.starts import Draw, Starts, with_foot_friction
from kickbench.mdp.term import randomization
from kickbench.spec.base import Range
from kickbench.spec.terms import RandomizationParams


class FootFriction(RandomizationParams):
    """Parameters of `foot_friction`."""

    range: Range
    """Range of the sliding friction coefficient."""


@randomization("3.1", units="1", needs=("foot_ball",), params=FootFriction)
def foot_friction(starts: Starts, params: FootFriction, draw: Draw) -> Starts:
    """Sliding friction of each foot, uniform, drawn anew for every foot and episode."""
    return with_foot_friction(starts, draw(*params.range, len(starts), 2))
