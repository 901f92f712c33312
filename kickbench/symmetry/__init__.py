"""The mirror group C2, its representations and the field tables built from them (numpy only).

A representation is a value: `a + b` is the direct sum, `tensor(a, b)` the product, `matrix()` the mirror itself,
`change_of_basis()` leads to the isotypic (sum and difference) form, `describe()` says it for people. A `FieldTable`
names the parts of a vector. Everything else in kickbench asks for these; only this folder knows the group.
"""

from kickbench.symmetry.field_table import FieldTable
from kickbench.symmetry.group import C2, Group
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
    "C2",
    "REGULAR",
    "REGULAR_SIGN",
    "SIGN",
    "TRIVIAL",
    "FieldTable",
    "Group",
    "Multiplicities",
    "Representation",
    "direct_sum",
    "regular",
    "tensor",
]
