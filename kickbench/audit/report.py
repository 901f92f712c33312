"""What an audit found: rows with verdicts, as a table for people and as JSON for machines."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from kickbench.results.tables import render_block

Verdict = Literal["ok", "FAIL", "unequal", "never excited", "partly excited", "measured", "not compared"]
"""`unequal`: a part of the robot is not the mirror image of its partner; `never excited`: nothing contradicts
the declaration, but every state left the quantity at zero, so nothing proves it; `partly excited`: the same
for some components; `measured`: nothing was declared."""


def verdict_of(*, wrong: bool, excited: bool = True) -> Verdict:
    """The verdict on a quantity that must transform as declared."""
    return "FAIL" if wrong else "ok" if excited else "never excited"


CHECKS = {
    "tables": "1 tables: joints against geometry",
    "dynamics": "2 dynamics: step(mirror(x), mirror(u)) against mirror(step(x, u))",
    "observations": "3 observations: obs(mirror(x)) against rho obs(x)",
    "terms": "4 rewards and terminations: invariant",
    "model": "5 model: geometry, masses, limits and gains against their mirror images",
    "policy": "6 policy: pi(rho o) against rho pi(o)",
}
Question = Literal["table", "robot", "policy"]
SECTIONS: dict[Question, str] = {
    "table": "Is the table right? (on the robot and its mirror image)",
    "robot": "Is the robot symmetric?",
    "policy": "Is the policy equivariant?",
}
BITS: dict[Question, int] = {"table": 1, "robot": 4, "policy": 8}
"""What a question adds to the exit code when its answer is no. 2 is that of wrong specifications."""


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
    def question(self) -> Question:
        """The question that the row helps to answer."""
        return "robot" if self.check == "model" else "policy" if self.check == "policy" else "table"


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
        but_for: Observation fields and joints that the method excludes from the symmetry.
    """

    task: str
    robot: str
    table: str
    states: int
    coverage: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    rows: tuple[Row, ...] = ()
    but_for: tuple[str, ...] = ()

    def failures(self, question: Question) -> tuple[Row, ...]:
        """Rows that say no to a question, in order."""
        return tuple(row for row in self.rows if row.failed and row.question == question)

    @property
    def exit_code(self) -> int:
        """The sum of the bits of all questions whose answer is no; see `BITS`."""
        return sum(bit for question, bit in BITS.items() if self.failures(question))

    @property
    def verdicts(self) -> dict[Question, str]:
        """The answer to every question that was asked, in one line each."""
        rows = {question: [row for row in self.rows if row.question == question] for question in SECTIONS}
        unproven = [row.name for row in rows["table"] if row.verdict.endswith("excited")]
        open_ends = f"; not proven, never or partly excited: {', '.join(unproven)}" if unproven else ""
        action = next((row for row in rows["policy"]), None)
        measured = action is not None and action.verdict == "measured"
        size = f"measured: {action.error:.2g} of {action.excited}" if action is not None else ""
        rest = f" but for: {', '.join(self.but_for)}" if self.but_for else ""
        yes: dict[Question, str] = {
            "table": f"right{open_ends}",
            "robot": "symmetric",
            "policy": f"{'not claimed' if measured else 'equivariant'}{rest}; {size}",
        }
        no = {"table": "WRONG", "robot": "unequal", "policy": "NOT EQUIVARIANT"}
        return {
            question: f"{no[question]}: {_first(failed)}"
            if (failed := self.failures(question))
            else yes[question]
            for question in SECTIONS
            if rows[question]
        }

    @property
    def conclusion(self) -> str:
        """One line: the first wrong entry of the table, whatever the robot is like, or all verdicts."""
        wrong = self.failures("table")
        return _first(wrong) if wrong else "; ".join(f"{q}: {text}" for q, text in self.verdicts.items())

    def as_json(self) -> dict[str, Any]:
        """The report as plain data; infinities become null."""
        rows = [{k: _finite(v) for k, v in asdict(row).items()} for row in self.rows]
        head = {k: v for k, v in asdict(self).items() if k != "rows"}
        answers = {"verdicts": self.verdicts, "exit_code": self.exit_code, "conclusion": self.conclusion}
        return {**head, "passed": not self.exit_code, **answers, "rows": rows}

    def lines(self) -> Iterator[str]:
        """The report for people."""
        yield f"audit of {self.task}: robot {self.robot}, table {self.table}"
        happened = ", ".join(f"{count} {what}" for what, count in self.coverage.items())
        if self.but_for:
            excluded = ", ".join(self.but_for)
            yield f"the method's symmetry: equivariant but for: {excluded} (zero in check 6)"
        yield f"{self.states} states in {self.seconds:.0f} s: {happened}"
        for question, verdict in self.verdicts.items():
            yield f"\n{SECTIONS[question]}"
            for check, title in CHECKS.items():
                rows = [row for row in self.rows if row.check == check and row.question == question]
                if rows:
                    header = ("", _ERROR.get(check, "worst error"), "tolerance", "excited", "verdict", "")
                    yield "\n" + render_block(title, header, [_cells(rows)], None)
            yield f"\n{question}: {verdict}"
        yield f"\n{self.conclusion}"


def _first(failures: Sequence[Row]) -> str:
    """The first of the rows that fail, in plain words, and how many others do."""
    first, others = failures[0], len(failures) - 1
    more = f" (and {others} more)" if others else ""
    return f"{first.name}: {first.detail or 'beyond tolerance'}{more}"


_ERROR = {"dynamics": "99 % below"}
"""What the column of errors has, where it is not the worst error."""


def _cells(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    width = max(len(row.detail) for row in rows)
    return [
        (
            row.name,
            "-" if row.error is None else f"{row.error:.2g} {row.unit}".rstrip(),
            "-" if row.tolerance is None else f"{row.tolerance:.1g}",
            row.excited,
            row.verdict,
            row.detail.ljust(width),
        )
        for row in rows
    ]


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
