"""What an audit found: rows with verdicts, as a table for people and as JSON for machines."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Verdict = Literal["ok", "FAIL", "never excited", "partly excited", "by design", "measured", "not compared"]
"""`never excited`: nothing contradicts the declaration, but every state left the quantity at zero, so nothing
proves it; `partly excited`: the same for some components; `by design`: asymmetric, and meant to be;
`measured`: nothing was declared."""


def verdict_of(*, wrong: bool, excited: bool = True) -> Verdict:
    """The verdict on a quantity that must transform as declared."""
    return "FAIL" if wrong else "ok" if excited else "never excited"


CHECKS = {
    "tables": "1 tables: rho^2 = 1, dimensions",
    "model": "2 model: geometry, masses, limits and gains against their mirror images",
    "dynamics": "3 dynamics: step(mirror(x), mirror(u)) against mirror(step(x, u))",
    "observations": "4 observations: obs(mirror(x)) against rho obs(x)",
    "terms": "5 rewards and terminations: invariant",
    "sampling": "6 sampling regions",
    "policy": "7 policy: pi(rho o) against rho pi(o)",
}


@dataclass(frozen=True)
class Row:
    """One line of the audit.

    Attributes:
        check: Key of `CHECKS`.
        name: Field, term, joint, body, ...
        verdict: See `Verdict`.
        error: Worst error, in `unit`; of motions the error that 99 % of the steps keep within; None where
            there is nothing to measure.
        tolerance: What is allowed.
        unit: Unit of both.
        excited: How much the quantity took part.
        detail: What is wrong, or what to know, in plain words.
    """

    check: str
    name: str
    verdict: Verdict
    error: float | None = None
    tolerance: float | None = None
    unit: str = ""
    excited: str = ""
    detail: str = ""

    @property
    def failed(self) -> bool:
        """Whether the row fails."""
        return self.verdict == "FAIL"


@dataclass(frozen=True)
class Report:
    """A whole audit.

    Attributes:
        task: Name of the task.
        robot: Path of the robot file.
        table: Path of the representation table.
        states: States audited.
        coverage: What happened in them: "kicks" -> number of states, ...
        seconds: How long it took.
        rows: One a field, term, joint, ...
    """

    task: str
    robot: str
    table: str
    states: int
    coverage: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    rows: tuple[Row, ...] = ()

    @property
    def failures(self) -> tuple[Row, ...]:
        """Rows that fail, in order."""
        return tuple(row for row in self.rows if row.failed)

    @property
    def conclusion(self) -> str:
        """One line: the first thing that is wrong, in plain words, or that nothing is wrong."""
        failures = self.failures
        if failures:
            first = failures[0]
            more = f" (and {len(failures) - 1} more rows fail)" if len(failures) > 1 else ""
            return f"{first.name}: {first.detail or 'beyond tolerance'}{more}"
        unproven = [row.name for row in self.rows if row.verdict in ("never excited", "partly excited")]
        proven = "no row fails"
        return f"{proven}; not proven, never or partly excited: {', '.join(unproven)}" if unproven else proven

    def as_json(self) -> dict[str, Any]:
        """The report as plain data; infinities become null."""
        rows = [{k: _finite(v) for k, v in asdict(row).items()} for row in self.rows]
        head = {k: v for k, v in asdict(self).items() if k != "rows"}
        return {**head, "passed": not self.failures, "conclusion": self.conclusion, "rows": rows}

    def lines(self) -> Iterator[str]:
        """The report for people."""
        yield f"audit of {self.task}: robot {self.robot}, table {self.table}"
        happened = ", ".join(f"{count} {what}" for what, count in self.coverage.items())
        yield f"{self.states} states in {self.seconds:.0f} s: {happened}"
        width = max((len(_short(row.name)) for row in self.rows), default=0)
        for check, title in CHECKS.items():
            rows = [row for row in self.rows if row.check == check]
            if rows:
                yield ""
                yield title
                yield from (_line(cells, width) for cells in _cells(rows))
        yield ""
        yield self.conclusion


_ERROR = {"dynamics": "99 % below"}
"""What the column of errors has, where it is not the worst error."""
_NAME = 52


def _cells(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    yield "", _ERROR.get(rows[0].check, "worst error"), "tolerance", "excited", "verdict", ""
    for row in rows:
        error = "-" if row.error is None else f"{row.error:.2g} {row.unit}".rstrip()
        tolerance = "-" if row.tolerance is None else f"{row.tolerance:.1g}"
        yield _short(row.name), error, tolerance, row.excited, row.verdict, row.detail


def _line(cells: tuple[str, ...], width: int) -> str:
    name, error, tolerance, excited, verdict, detail = cells
    return f"  {name:<{width}}  {error:>14}  {tolerance:>9}  {excited:<22}  {verdict:<14}  {detail}".rstrip()


def _short(name: str) -> str:
    return name if len(name) <= _NAME else name[: _NAME - 3] + "..."


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
