"""Verb `audit`."""

from __future__ import annotations

import argparse
import json

from kickbench.audit.run import STATES, AuditRequest, audit


def run(arguments: argparse.Namespace) -> int:
    """`kickbench audit TASK [METHOD]`: exit code 1 if a row fails."""
    report = audit(
        AuditRequest(
            task=arguments.task,
            table=arguments.method,
            run=arguments.policy,
            states=arguments.states or STATES,
            seed=arguments.seed,
            overrides=tuple(arguments.overrides),
            threads=arguments.threads,
        )
    )
    print(json.dumps(report.as_json(), indent=2) if arguments.json else "\n".join(report.lines()))
    return 1 if report.failures else 0
