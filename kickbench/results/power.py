"""How often a claim would be met by an exact replication, and how often although it is wrong.

Seeds of each condition are drawn from a normal distribution with the reported mean and standard deviation, a
success rate is then counted over the planned episodes, and the very code that judges measured runs judges
what was drawn. Three worlds are drawn from: the reported one; one in which all conditions have the mean of
the reported means; and one in which the condition that a claim is about succeeds 15 points less often than
reported, its ball stopping 0.19 m farther away (what 15 points are worth in Table 4.2: its three pairs of
figures lie on a line of -0.0125 m a point).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kickbench.config.experiment import AnyClaim, Compared, NearReported, Operand
from kickbench.results.contrast import RunTerms, Term, contrast_of
from kickbench.results.quantities import Figure
from kickbench.results.statistics import wilson
from kickbench.results.tables import render_block
from kickbench.results.verdicts import judge_parts
from kickbench.trials.experiment import LoadedExperiment

WORSE: Mapping[str, float] = {"success_rate": -0.15, "mean_distance": 0.19}
"""What the condition of a claim differs by in the world in which it is worse."""
LEAST_POWER, MOST_FALSE = 0.7, 0.1
"""What a claim must reach to be decidable: met so often by a replication, so rarely where it is wrong."""
_SEED = 0


@dataclass(frozen=True)
class Rates:
    """How often a claim is met.

    Attributes:
        replication: Where the reported figures are true.
        equal: Where all conditions are equal; None for a claim that is about one condition, or that they are
            equal.
        worse: Where the claim's condition is worse by `WORSE`.
    """

    replication: float
    equal: float | None
    worse: float

    @property
    def decides(self) -> bool:
        """Whether a verdict means something."""
        false = max(self.worse, self.equal or 0.0)
        return self.replication >= LEAST_POWER and false <= MOST_FALSE


def rates(experiment: LoadedExperiment, draws: int = 2000) -> dict[str, Rates]:
    """The rates of every claim whose figures were reported with their deviations.

    Args:
        experiment: The experiment; its numbers of seeds and episodes are those drawn.
        draws: Replications in each world.
    """
    found = {}
    for name, claim in experiment.claims.items():
        if claim.metric in WORSE and all(_reported(experiment, o, claim) for o in claim.operands().values()):
            met = {
                world: _met(experiment, claim, world, draws) for world in ("replication", "equal", "worse")
            }
            compares = isinstance(claim, Compared)
            found[name] = Rates(met["replication"], met["equal"] if compares else None, met["worse"])
    return found


def rates_table(experiment: LoadedExperiment, draws: int = 2000) -> str:
    """The rates as a table."""
    rows = []
    for name, found in rates(experiment, draws).items():
        equal = "-" if found.equal is None else f"{100 * found.equal:.1f}"
        judged = "yes" if found.decides else "no"
        rows.append([(name, f"{100 * found.replication:.1f}", equal, f"{100 * found.worse:.1f}", judged)])
    header = ("claim, met [%]", "replication", "equal methods", "15 points worse", "decidable")
    return render_block(f"{experiment.name}: {draws:,} draws", header, rows)


def _reported(experiment: LoadedExperiment, operand: Operand, claim: AnyClaim) -> tuple[float, float] | None:
    """Mean and standard deviation over seeds as reported; None if they were not."""
    figures = experiment.conditions[operand.condition].figures_of(operand)
    mean, deviation = (getattr(figures, f"{claim.metric}{end}", None) for end in ("", "_std"))
    return None if mean is None or deviation is None else (mean, deviation)


def _met(experiment: LoadedExperiment, claim: AnyClaim, world: str, draws: int) -> float:
    """Share of the draws of a world in which a claim is met."""
    rng = np.random.default_rng(_SEED)
    value = _reported(experiment, claim.value, claim)
    contrast = contrast_of(claim, value[0] if value and isinstance(claim, NearReported) else None)
    others = [_reported(experiment, operand, claim) for operand in claim.operands().values()]
    middle = float(np.mean([other[0] for other in others if other]))
    count = 0
    for _ in range(draws):
        parts: dict[str, list[RunTerms]] = {}
        for weight, operand in contrast.terms:
            mean, deviation = _reported(experiment, operand, claim) or (0.0, 0.0)
            mean = middle if world == "equal" else mean
            mean += WORSE[claim.metric] if world == "worse" and operand == claim.value else 0.0
            planned = experiment.conditions[operand.condition]
            drawn = rng.normal(mean, deviation, len(planned.seeds))
            parts[operand.condition] = [
                RunTerms((Term(weight, operand, _figure(claim, seed, planned.episodes, rng)),))
                for seed in drawn
            ]
        count += judge_parts(claim, contrast, parts)[0] == "met"
    return count / draws


def _figure(claim: AnyClaim, seed: float, episodes: int, rng: np.random.Generator) -> Figure:
    """What is measured of a seed: a rate with what its episodes leave open; a distance as it is."""
    if claim.metric != "success_rate":
        return Figure(max(0.0, seed))
    successes = int(rng.binomial(episodes, min(1.0, max(0.0, seed))))
    return Figure(successes / episodes, wilson(successes, episodes))
