"""Verb `export`."""

from __future__ import annotations

import argparse

from kickbench.deploy.export import export as write
from kickbench.errors import shown


def export(arguments: argparse.Namespace) -> int:
    """`kickbench export RUN`."""
    print(shown(write(arguments.run, arguments.out, states=arguments.states, force=arguments.force)))
    return 0
