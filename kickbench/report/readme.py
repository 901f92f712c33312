"""`kickbench report --readme`: what was measured, from `results/measured`, between two marks of two files.

`README.md` has one table and one picture; `results/README.md` has every figure, verdict and effort.

Everything is a function of the files in `results/`: the same files give the same text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from kickbench.errors import KickbenchError
from kickbench.report.figures.canvas import Picture
from kickbench.report.figures.dots import draw_dots
from kickbench.report.figures.legs import draw_legs, legs_of
from kickbench.report.figures.slopes import Pair, draw_slopes
from kickbench.report.headline import Claimed, warnings
from kickbench.report.palette import looks_of
from kickbench.report.spread import DISTANCE, SUCCESS, Measure, Spread, spreads
from kickbench.report.study import Study, studies
from kickbench.report.tables import (
    Cell,
    commit_text,
    comparison_table,
    further_rows,
    further_table,
    hardware,
    hours,
    reported_of,
)
from kickbench.report.write import judged
from kickbench.results.atomic import atomic_write_text
from kickbench.trials.experiment import load_experiment

BEGIN = "<!-- results: written by `kickbench report --readme` from results/measured; do not edit by hand -->"
END = "<!-- results: end -->"
PICTURES = "results/pictures"
_WIDTH = 640

Result = tuple[Study, tuple[Claimed, ...]]


def write_readme(root: Path) -> tuple[Path, ...]:
    """Writes the results of both READMEs and their pictures.

    Args:
        root: The checkout, with `README.md`, `results/reported` and `results/measured`.

    Returns:
        The files written.

    Raises:
        KickbenchError: The README has no marks, or there are no results.
    """
    results = measured_results(root)
    texts = {
        file: replaced(_read(file), body, str(file))
        for file, body in (
            (root / "README.md", summary(results)),
            (root / "results/README.md", section(results)),
        )
    }
    files = []
    for picture in (*pictures(results), slopes(results)):
        files.append(root / PICTURES / f"{picture.name}.svg")
        atomic_write_text(files[-1], picture.svg + "\n")
    for file, text in texts.items():
        atomic_write_text(file, text)
    return (*files, *texts)


def measured_results(root: Path) -> tuple[Result, ...]:
    """Every folder of `results/measured`: as its experiment plans it, if `results/reported` has one of its name."""
    folders = sorted(path for path in (root / "results/measured").glob("*") if path.is_dir())
    if not folders:
        raise KickbenchError(f"{root / 'results/measured'}: no results")
    results: list[Result] = []
    for folder in folders:
        spec = root / "results/reported" / f"{folder.name}.yaml"
        if spec.is_file():
            experiment = load_experiment(spec)
            claims, problems = judged(folder, experiment)
            if problems:
                raise KickbenchError(problems[0])
            results += [(study, claims) for study in studies(folder, experiment)]
        else:
            results += [(replace(study, name=folder.name), ()) for study in studies(folder)]
    return tuple(results)


def replaced(readme: str, body: str, name: str) -> str:
    """The README with another text between the marks.

    Raises:
        KickbenchError: The marks are not there, each once and in order.
    """
    if readme.count(BEGIN) != 1 or readme.count(END) != 1 or readme.index(BEGIN) > readme.index(END):
        raise KickbenchError(f"{name}: expected, each once and in this order, the lines\n{BEGIN}\n{END}")
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{body}\n\n{END}{after}"


def summary(results: tuple[Result, ...]) -> str:
    """The text between the marks of `README.md`: success of every condition, and the picture of what it loses."""
    head = ["Task", "Method", "Seeds", "Success [%]", "Mirrored [%]", "Distance [m]"]
    lines = [_row(head), _row(["---"] * len(head))]
    for study in _planned(results):
        own = study.counted()
        for condition in dict.fromkeys(own.condition):
            cells = [
                _mean(study, condition, side, measure)
                for side, measure in (
                    ("in_distribution", SUCCESS),
                    ("mirrored", SUCCESS),
                    ("in_distribution", DISTANCE),
                )
            ]
            seeds = str(own[own.condition == condition].seed.nunique())
            lines.append(_row([study.name, condition, seeds, *cells]))
    return "\n".join([*lines, "", _image(slopes(results))])


def _planned(results: tuple[Result, ...]) -> list[Study]:
    """The results that an experiment plans; of others, such as earlier recipes, `results/README.md` tells."""
    return [study for study, _ in results if study.plans]


def _mean(study: Study, condition: str, side: str, measure: Measure) -> str:
    """Mean over seeds, with their standard deviation."""
    found = [
        of for of in spreads(study.rows, [condition], measure) if of.side == side and of.mean is not None
    ]
    if not found:
        return "-"
    (spread,) = found
    std = "" if spread.std is None else f" ± {measure.text(spread.std)}"
    return f"{measure.text(spread.mean or 0.0)}{std}"


def slopes(results: tuple[Result, ...]) -> Picture:
    """Success of every method in distribution and mirrored, where both were measured."""
    groups: dict[str, list[Pair]] = {}
    for study in _planned(results):
        found = spreads(study.rows, study.conditions, SUCCESS)
        for condition in study.conditions:
            sides = {of.side: of for of in found if of.arm == condition and of.seeds}
            if len(sides) == 2:
                pair = (condition, sides["in_distribution"], sides["mirrored"])
                groups.setdefault(study.name, []).append(pair)
    conditions = {name: method for study, _ in results for name, method in study.conditions.items()}
    return draw_slopes(
        groups, SUCCESS, looks_of(conditions.items()), "home-field", width=_WIDTH, themed=False
    )


def section(results: tuple[Result, ...]) -> str:
    """The text between the marks of `results/README.md`: tables, verdicts, what to know before believing them."""
    parts = [_study_text(study, claims) for study, claims in results]
    return "\n\n".join([*parts, *(_image(of, "pictures") for of in pictures(results))])


def _image(picture: Picture, folder: str = PICTURES) -> str:
    return f"![{picture.title}]({folder}/{picture.name}.svg)"


def pictures(results: tuple[Result, ...]) -> tuple[Picture, Picture]:
    """Success of every method on either side, and which foot kicked."""
    rows: list[tuple[Spread, str]] = []
    for study, _ in results:
        for spread in spreads(study.rows, study.conditions, SUCCESS, reported_of(study)):
            if spread.seeds:
                side = "" if spread.side == "in_distribution" else ", mirrored"
                rows.append((spread, f"{study.name}: {spread.arm}{side}"))
    arms = {arm: method for study, _ in results for arm, method in study.conditions.items()}
    success = draw_dots(
        [spread for spread, _ in rows], SUCCESS, looks_of(arms.items()), "success",
        names=[name for _, name in rows], width=_WIDTH, themed=False,
    )  # fmt: skip
    legs = []
    for study, _ in results:
        own = study.rows[study.rows.counted & (study.rows.evaluated_on == study.rows.task)]
        for (arm, seed), sides in own.groupby(["condition", "seed"], sort=False):
            legs.append(legs_of(sides, f"{study.name}: {arm}, seed {seed}"))
    return success, draw_legs(legs, "feet", width=_WIDTH)


def _study_text(study: Study, claims: tuple[Claimed, ...]) -> str:
    lines = [f"**`{_plain(study.name)}`**{f': {_plain(study.question)}' if study.question else ''}", ""]
    table = comparison_table(study)
    # Methods that have not been run are named below the table.
    ran = set(study.counted().condition)
    rows = [(_texts(row[:-1]), row[0].text) for row in table.rows if row[0].text in ran]
    lines += _table(study, table.columns[:-1], rows)
    if further := further_table(study):
        rows = [(_texts(cells), arm) for arm, cells in further_rows(study)]
        lines += ["", f"{further.caption}:", ""]
        lines += _table(study, further.columns, rows)
    if claims:
        lines += ["", *_claim_lines(claims)]
    notes = [
        *warnings(study),
        *(f"results/measured/{study.name}/{note.place} says more of these runs." for note in study.notes),
    ]
    if notes:
        lines += ["", *(f"- Note: {_plain(note)}" for note in notes)]
    return "\n".join(lines)


def _claim_lines(claims: tuple[Claimed, ...]) -> list[str]:
    """The claims that something was measured for, and how many others there are."""
    told = [of for of in claims if of.measured]
    lines = [f"- {_plain(of.statement)}: **{of.words}**, {_plain(_evidence(of))}" for of in told]
    rest = len(claims) - len(told)
    if rest:
        lines.append(
            f"- {rest} more {'claim is' if rest == 1 else 'claims are'} about runs that are missing."
        )
    return lines


def _evidence(claim: Claimed) -> str:
    return "; ".join(filter(None, (claim.figure, claim.reported)))


def _effort(study: Study, arm: str) -> list[str]:
    """Iterations, steps, hours, hardware and commit of a condition's runs, each value once."""
    runs = study.counted(arm)
    columns = (
        [_iterations(study, arm, int(done)) for done in runs.iterations],
        [f"{steps:,.0f}" for steps in runs.env_steps],
        _range(list(runs.training_seconds)),
        [hardware(of) for of in runs.provenance],
        [commit_text(of) for of in runs.provenance],
    )
    # Hardware has commas of its own.
    return ["; ".join(dict.fromkeys(values)) or "none" for values in columns]


def _iterations(study: Study, arm: str, done: int) -> str:
    planned = study.plans[arm].iterations if arm in study.plans else done
    return f"{done:,}" if done == planned else f"{done:,} of {planned:,}"


def _range(seconds: list[float]) -> list[str]:
    """Shortest and longest time."""
    ends = dict.fromkeys(map(hours, (min(seconds), max(seconds)))) if seconds else {}
    return [" to ".join(ends)] if ends else []


def _table(study: Study, columns: Sequence[str], rows: Sequence[tuple[list[str], str]]) -> list[str]:
    """A table with what the runs of each row's arm took in its last columns."""
    head = [*columns, "Iterations", "Steps a run", "Training a run", "Hardware", "Commit"]
    return [
        _row(head),
        _row(["---"] * len(head)),
        *(_row([*cells, *_effort(study, arm)]) for cells, arm in rows),
    ]


def _texts(row: Sequence[Cell]) -> list[str]:
    return [f"{cell.text} ({cell.note})" if cell.note else cell.text for cell in row]


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(_plain(cell) for cell in cells)} |"


def _plain(text: str) -> str:
    """A text that Markdown shows as it is, in one line."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise KickbenchError(f"{path}: cannot read it: {error.strerror}") from None
