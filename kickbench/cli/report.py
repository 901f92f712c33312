"""Verb `report`."""

from __future__ import annotations

import argparse

from kickbench.errors import KickbenchError, shown


def report(arguments: argparse.Namespace) -> int:
    """`kickbench report DIR`: one page; `kickbench report --readme`: the README's results."""
    if arguments.readme:
        if arguments.folder or arguments.out or arguments.experiment:
            raise KickbenchError("--readme takes results/measured and README.md: no DIR, -o or --experiment")
        from kickbench.report.readme import write_readme

        for path in write_readme(arguments.root):
            print(path)
        return 0
    if arguments.folder is None:
        raise KickbenchError("expected a folder of runs: kickbench report DIR, or kickbench report --readme")
    from kickbench.report.write import write_report
    from kickbench.reported import load_reported

    experiment = load_reported(arguments.experiment) if arguments.experiment else None
    out = arguments.out or arguments.folder / "report.html"
    write_report(arguments.folder, out, experiment)
    print(shown(out))
    return 0
