"""What an audit found: rows with verdicts, as a table for people and as JSON for machines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic_core import to_jsonable_python

from kickbench.results.tables import render_block

Verdict = Literal["ok", "FAIL", "unequal", "never excited", "partly excited", "measured", "not compared"]
"""`unequal`: a part of the robot is not the mirror image of its partner; `never excited`: nothing contradicts
the declaration, but every state left the quantity at zero, so nothing proves it; `partly excited`: the same
for some components; `measured`: nothing was declared."""

CHECKS = {
    "tables": "1 tables: joints against geometry",
    "dynamics": "2 dynamics: step(mirror(x), mirror(u)) against mirror(step(x, u))",
    "observations": "3 observations: obs(mirror(x)) against rho obs(x)",
    "terms": "4 rewards and terminations: invariant",
    "model": "5 model: geometry, masses, limits and gains against their mirror images",
    "policy": "6 policy: pi(rho o) against rho pi(o)",
}
_NO = {"table": (1, "WRONG"), "robot": (4, "unequal"), "policy": (8, "NOT EQUIVARIANT")}
"""Is the table right, the robot symmetric, the policy equivariant? What a no adds to the exit code, in which
2 is that of wrong specifications, and how it is said."""
_HEADER = ("", "error", "tolerance", "excited", "verdict", "")


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
        """Whether the row says no to its question."""
        return self.verdict in ("FAIL", "unequal")

    @property
    def question(self) -> str:
        """What the row helps to judge: table, robot or policy."""
        return {"model": "robot", "policy": "policy"}.get(self.check, "table")

    def cells(self, width: int) -> tuple[str, ...]:
        """The line in a table whose details are so wide."""
        error = "-" if self.error is None else f"{self.error:.2g} {self.unit}".rstrip()
        tolerance = "-" if self.tolerance is None else f"{self.tolerance:.1g}"
        return self.name, error, tolerance, self.excited, self.verdict, self.detail.ljust(width)


@dataclass(frozen=True)
class Report:
    """A whole audit.

    Attributes:
        task: Name of the task.
        robot: Path of the robot file.
        table: Path of the representation table.
        states: States audited.
        rows: One a field, term, joint, ...
        but_for: Observation fields and joints that the method excludes from the symmetry.
    """

    task: str
    robot: str
    table: str
    states: int
    rows: tuple[Row, ...] = ()
    but_for: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """The sum of the bits of all questions whose answer is no."""
        return sum(_NO[question][0] for question in {row.question for row in self.rows if row.failed})

    @property
    def verdicts(self) -> dict[str, str]:
        """The answer to every question that was asked, in one line each; the table's is the last."""
        asked = {name: [row for row in self.rows if row.question == name] for name in reversed(_NO)}
        return {name: self._verdict(name, rows) for name, rows in asked.items() if rows}

    def _verdict(self, question: str, rows: Sequence[Row]) -> str:
        if failed := [row for row in rows if row.failed]:
            more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
            return f"{_NO[question][1]}: {failed[0].name}: {failed[0].detail or 'beyond tolerance'}{more}"
        if question == "policy":
            claimed = "not claimed" if rows[0].verdict == "measured" else "equivariant"
            rest = f" but for: {', '.join(self.but_for)}" if self.but_for else ""
            return f"{claimed}{rest}; measured: {rows[0].error:.2g} of {rows[0].excited}"
        unproven = ", ".join(row.name for row in rows if row.verdict.endswith("excited"))
        right = "right" if question == "table" else "symmetric"
        return f"{right}; not proven, never or partly excited: {unproven}" if unproven else right

    def as_json(self) -> dict[str, Any]:
        """The report as plain data; infinities become null."""
        head = to_jsonable_python(self, inf_nan_mode="null")
        found = {"verdicts": self.verdicts, "exit_code": self.exit_code, "rows": head.pop("rows")}
        return {**head, "passed": not self.exit_code, **found}

    def lines(self) -> Iterator[str]:
        """The report for people."""
        yield f"audit of {self.task}: robot {self.robot}, table {self.table}"
        if self.but_for:
            excluded = ", ".join(self.but_for)
            yield f"the method's symmetry: equivariant but for: {excluded} (zero in check 6)"
        yield f"{self.states} states"
        for check, title in CHECKS.items():
            if rows := [row for row in self.rows if row.check == check]:
                width = max(len(row.detail) for row in rows)
                yield "\n" + render_block(title, _HEADER, [[row.cells(width) for row in rows]], None)
        yield ""
        yield from (f"{question}: {verdict}" for question, verdict in self.verdicts.items())
