"""What an audit found: rows with verdicts, as a table for people and as JSON for machines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from pydantic_core import to_jsonable_python

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


class Question(NamedTuple):
    """A question that an audit answers.

    Attributes:
        heading: In words.
        bit: What it adds to the exit code when its answer is no. 2 is that of wrong specifications.
        no: That answer.
    """

    heading: str
    bit: int
    no: str


QUESTIONS = {
    "table": Question("Is the table right? (on the robot and its mirror image)", 1, "WRONG"),
    "robot": Question("Is the robot symmetric?", 4, "unequal"),
    "policy": Question("Is the policy equivariant?", 8, "NOT EQUIVARIANT"),
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
        """Whether the row says no to its question."""
        return self.verdict in ("FAIL", "unequal")

    @property
    def question(self) -> str:
        """The question that the row helps to answer."""
        return {"model": "robot", "policy": "policy"}.get(self.check, "table")

    @property
    def cells(self) -> tuple[str, ...]:
        """The line in a table."""
        error = "-" if self.error is None else f"{self.error:.2g} {self.unit}".rstrip()
        tolerance = "-" if self.tolerance is None else f"{self.tolerance:.1g}"
        return self.name, error, tolerance, self.excited, self.verdict, self.detail


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

    def failures(self, question: str) -> list[Row]:
        """Rows that say no to a question, in order."""
        return [row for row in self.rows if row.failed and row.question == question]

    @property
    def exit_code(self) -> int:
        """The sum of the bits of all questions whose answer is no."""
        return sum(question.bit for name, question in QUESTIONS.items() if self.failures(name))

    @property
    def verdicts(self) -> dict[str, str]:
        """The answer to every question that was asked, in one line each."""
        rows = {name: [row for row in self.rows if row.question == name] for name in QUESTIONS}
        unproven = ", ".join(row.name for row in rows["table"] if row.verdict.endswith("excited"))
        yes = {
            "table": f"right; not proven, never or partly excited: {unproven}" if unproven else "right",
            "robot": "symmetric",
        }
        for action in rows["policy"]:
            claimed = "not claimed" if action.verdict == "measured" else "equivariant"
            rest = f" but for: {', '.join(self.but_for)}" if self.but_for else ""
            yes["policy"] = f"{claimed}{rest}; measured: {action.error:.2g} of {action.excited}"
        failed = {name: self.failures(name) for name in QUESTIONS if rows[name]}
        return {n: f"{QUESTIONS[n].no}: {_first(no)}" if no else yes[n] for n, no in failed.items()}

    @property
    def conclusion(self) -> str:
        """One line: the first wrong entry of the table, whatever the robot is like, or all verdicts."""
        wrong = self.failures("table")
        return _first(wrong) if wrong else "; ".join(f"{q}: {text}" for q, text in self.verdicts.items())

    def as_json(self) -> dict[str, Any]:
        """The report as plain data; infinities become null."""
        head = to_jsonable_python(self, inf_nan_mode="null")
        rows, answers = head.pop("rows"), ("verdicts", "exit_code", "conclusion")
        return {**head, "passed": not self.exit_code, **{k: getattr(self, k) for k in answers}, "rows": rows}

    def lines(self) -> Iterator[str]:
        """The report for people."""
        yield f"audit of {self.task}: robot {self.robot}, table {self.table}"
        happened = ", ".join(f"{count} {what}" for what, count in self.coverage.items())
        if self.but_for:
            excluded = ", ".join(self.but_for)
            yield f"the method's symmetry: equivariant but for: {excluded} (zero in check 6)"
        yield f"{self.states} states in {self.seconds:.0f} s: {happened}"
        for question, verdict in self.verdicts.items():
            yield f"\n{QUESTIONS[question].heading}"
            for check, title in CHECKS.items():
                cells = [row.cells for row in self.rows if row.check == check and row.question == question]
                if cells:
                    width = max(len(detail) for *_, detail in cells)
                    cells = [(*others, detail.ljust(width)) for *others, detail in cells]
                    header = ("", _ERROR.get(check, "worst error"), "tolerance", "excited", "verdict", "")
                    yield "\n" + render_block(title, header, [cells], None)
            yield f"\n{question}: {verdict}"
        yield f"\n{self.conclusion}"


def _first(failures: Sequence[Row]) -> str:
    """The first of the rows that fail, in plain words, and how many others do."""
    first, others = failures[0], len(failures) - 1
    more = f" (and {others} more)" if others else ""
    return f"{first.name}: {first.detail or 'beyond tolerance'}{more}"


_ERROR = {"dynamics": "99 % below"}
"""What the column of errors has, where it is not the worst error."""
