"""How much of its room for contacts and constraints an engine has used."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EngineLoad:
    """Use of an engine's room since it was last asked.

    Attributes:
        contacts: Most contacts in a substep, a world on average.
        constraints: Most constraint rows of any world in a substep.
        contact_room: Contacts there is room for, a world on average.
        constraint_room: Constraint rows there is room for in every world.
        short_share: Share of the control steps, over all worlds, in which something did not fit.
    """

    contacts: float
    constraints: int
    contact_room: int
    constraint_room: int
    short_share: float
