"""`plan.json`: which runs a folder is to hold, so that `kickbench status` knows what is missing."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Literal

from pydantic import Field, NonNegativeInt, PositiveInt, ValidationError

from kickbench.errors import KickbenchError
from kickbench.results.atomic import Record, atomic_write_text

FILE = "plan.json"


class RunRecord(Record):
    """One run of a plan; its folder is `<arm>/seed<seed>`."""

    arm: str
    seed: NonNegativeInt
    task: str
    method: str
    iterations: PositiveInt
    episodes: PositiveInt = Field(description="evaluation episodes a side")
    also: tuple[str, ...] = Field(default=(), description="further tasks that the policy is evaluated on")

    @property
    def folder(self) -> Path:
        """Where it lies in the plan's folder."""
        return Path(self.arm, f"seed{self.seed}")


class PlanRecord(Record):
    """What an experiment asks of a folder: all its runs, whether or not they have been asked for yet."""

    schema_version: Literal[1] = 1
    experiment: str
    scale: float | None = Field(default=None, gt=0, lt=1, description="as in metrics.json")
    overrides: tuple[str, ...] = Field(default=(), description="`--set` texts beyond the experiment's file")
    runs: tuple[RunRecord, ...]
    sha256: str | None = Field(default=None, description="of the other fields")

    def signed(self) -> PlanRecord:
        """The record with its own SHA-256."""
        text = self.model_dump_json(exclude={"sha256"})
        return self.model_copy(update={"sha256": hashlib.sha256(text.encode()).hexdigest()})

    def title(self, folder: str) -> str:
        """The experiment, in what the runs differ from it, and where they are."""
        scaled = [f"scaled down to {self.scale:g}"] if self.scale else []
        return (
            f"{', '.join([self.experiment, *scaled, *(f'with --set {o}' for o in self.overrides)])}: {folder}"
        )


def write_record(folder: Path, record: PlanRecord) -> None:
    """Writes a folder's plan, atomically."""
    atomic_write_text(folder / FILE, record.signed().model_dump_json(indent=2) + "\n")


def read_record(folder: Path) -> PlanRecord | None:
    """Reads a folder's plan; None if it has none.

    Raises:
        KickbenchError: It is not valid.
    """
    path = folder / FILE
    try:
        record = PlanRecord.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise KickbenchError(f"{path}: no valid plan of an experiment: {error}") from error
    if record.sha256 not in (None, record.signed().sha256):
        raise KickbenchError(f"{path}: damaged: its SHA-256 is wrong; reproduce writes it again")
    return record.model_copy(update={"sha256": None})
