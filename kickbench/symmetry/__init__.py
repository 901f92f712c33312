"""The mirror group C2, its representations and the field tables built from them (numpy only)."""

from kickbench.symmetry.field_table import FieldTable
from kickbench.symmetry.representation import (
    BY_NAME,
    REGULAR,
    REGULAR_SIGN,
    SIGN,
    TRIVIAL,
    Multiplicities,
    Representation,
    direct_sum,
    regular,
    tensor,
)

__all__ = [
    "BY_NAME",
    "REGULAR",
    "REGULAR_SIGN",
    "SIGN",
    "TRIVIAL",
    "FieldTable",
    "Multiplicities",
    "Representation",
    "direct_sum",
    "regular",
    "tensor",
]
