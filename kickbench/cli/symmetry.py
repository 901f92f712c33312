"""Verb `symmetry derive`."""

from __future__ import annotations

import argparse

from kickbench.errors import KickbenchError


def derive(arguments: argparse.Namespace) -> int:
    """`kickbench symmetry derive MODEL`: the `symmetry:` block of a robot file, derived from the MJCF's geometry."""
    from kickbench.scene.skeleton import compile_skeleton
    from kickbench.symmetry.block import symmetry_block
    from kickbench.symmetry.derive import derive as derive_from

    if not arguments.model.is_file():
        what = "a folder, no file" if arguments.model.is_dir() else "no such file"
        raise KickbenchError(f"{arguments.model}: {what}")
    derivation = derive_from(compile_skeleton(arguments.model), arguments.plane)
    print(symmetry_block(derivation, arguments.model.name))
    return 1 if derivation.unclear else 0
