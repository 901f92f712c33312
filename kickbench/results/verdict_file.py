"""The file `verdicts.json`: what an experiment's claims came to, kept beside its runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field, TypeAdapter, ValidationError

from kickbench.errors import KickbenchError
from kickbench.results.record import Record
from kickbench.results.statistics import Interval
from kickbench.results.verdicts import Outcome, Verdict


class RecordedVerdict(Record):
    """A verdict in its file."""

    name: str = Field(description="name of the claim")
    statement: str = Field(description="the claim in words")
    outcome: Outcome
    figure: float | None = Field(description="what the claim compares with its bound; null: not measured")
    interval: Interval | None = Field(description="its 95 % interval; null: not known")
    basis: str = Field(description="what the interval covers")
    reason: str | None = Field(description="why there is not enough data")


_FILE = TypeAdapter(list[RecordedVerdict])


def recorded_form(verdicts: Sequence[Verdict]) -> list[RecordedVerdict]:
    """Verdicts as they are recorded."""
    return [
        RecordedVerdict(
            name=verdict.name,
            statement=verdict.claim.statement,
            outcome=verdict.outcome,
            figure=verdict.figure,
            interval=verdict.interval,
            basis=verdict.basis,
            reason=verdict.reason,
        )
        for verdict in verdicts
    ]


def verdicts_json(verdicts: Sequence[Verdict]) -> str:
    """The text of the file, without a final newline."""
    return _FILE.dump_json(recorded_form(verdicts), indent=2).decode()


def read_verdicts(path: Path) -> list[RecordedVerdict]:
    """Read a `verdicts.json`.

    Raises:
        KickbenchError: the file is missing or not valid; the message names the file and every wrong key.
    """
    try:
        return _FILE.validate_json(Path(path).read_bytes())
    except OSError as error:
        raise KickbenchError(f"{path}: cannot read verdicts: {error.strerror}") from error
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, item['loc'])) or 'file'}: {item['msg']}" for item in error.errors()
        )
        raise KickbenchError(f"{path}: no valid verdicts: {problems}") from error
