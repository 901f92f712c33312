"""`kickbench report --readme`: what was measured, from `results/measured`, between two marks of two files.

`README.md` has one table and one picture; `results/README.md` has every figure, verdict and effort.

Everything is a function of the files in `results/`: the same files give the same text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from kickbench.errors import KickbenchError
from kickbench.report import contents, plots
from kickbench.report.contents import evidence, verdict_words, warnings
from kickbench.report.reported import beside_reported, whole_trainings
from kickbench.report.study import Study, studies
from kickbench.report.style import Picture, looks_of, style
from kickbench.results.atomic import atomic_write_text
from kickbench.results.episode_table import SIDES
from kickbench.results.frame import HOME
from kickbench.results.quantities import DISTANCE, PERCENT, SUCCESS, Quantity
from kickbench.results.verdicts import Verdict
from kickbench.trials.experiment import load_experiment

BEGIN = "<!-- results: written by `kickbench report --readme` from results/measured; do not edit by hand -->"
END = "<!-- results: end -->"
PICTURES = "results/pictures"
_WIDTH = 640


def write_readme(root: Path) -> list[Path]:
    """Writes the results of both READMEs and their pictures.

    Args:
        root: The checkout, with `README.md`, `results/reported` and `results/measured`.

    Returns:
        The files written.

    Raises:
        KickbenchError: The README has no marks, or there are no results.
    """
    found = measured_results(root)
    with style():
        drawn = pictures(found)
        texts = {root / PICTURES / f"{name}.svg": of.svg() for name, of in drawn.items()}
    for name, body in (("README.md", summary(found, drawn)), ("results/README.md", section(found, drawn))):
        texts[root / name] = replaced(root / name, body)
    for file, text in texts.items():
        atomic_write_text(file, text)
    return list(texts)


def measured_results(root: Path) -> list[Study]:
    """Every folder of `results/measured`, as the experiment of its name in `results/reported` plans it.

    Raises:
        KickbenchError: There is none, or the claims of one cannot be judged.
    """
    folders = sorted(path for path in (root / "results/measured").glob("*") if path.is_dir())
    if not folders:
        raise KickbenchError(f"{root / 'results/measured'}: no results")
    found = []
    for folder in folders:
        spec = root / "results/reported" / f"{folder.name}.yaml"
        experiment = load_experiment(spec) if spec.is_file() else None
        found += [replace(study, name=folder.name) for study in studies(folder, experiment)]
    return found


def replaced(file: Path, body: str) -> str:
    """The text of a README with another text between the marks.

    Raises:
        KickbenchError: It cannot be read, or the marks are not there, each once and in order.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        raise KickbenchError(f"{file}: cannot read it: {error.strerror}") from None
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise KickbenchError(f"{file}: expected, each once and in this order, the lines\n{BEGIN}\n{END}")
    before, after = text.partition(BEGIN)[0], text.partition(END)[2]
    return f"{before}{BEGIN}\n\n{body}\n\n{END}{after}"


def pictures(results: Sequence[Study]) -> dict[str, Picture]:
    """The pictures by name: what conditions lose on the mirrored side, and success."""
    drawn = dict[str, Picture]()
    for study in results:
        if len(rows := study.swept(SUCCESS)):
            figure = plots.over_setting(rows, looks_of(rows.of), _WIDTH)
            drawn[study.name] = Picture(f"Success over {rows.setting.iloc[0]}", figure, _means(rows))
    looks = looks_of(name for study in results for name in study.conditions)
    for study in results:
        if len(curves := whole_trainings(study, results)):
            title = "Exploration over the samples of the whole training"
            figure = plots.over_samples(curves, looks, _WIDTH)
            drawn[f"{study.name}-learning"] = Picture(title, figure, _progress_words(curves))
    runs = pd.concat([study.measured for study in results])
    estimates = pd.concat([study.estimates(SUCCESS) for study in results])
    runs, estimates = (of.assign(label=of.study + ": " + of.label) for of in (runs, estimates))
    estimates = estimates[estimates.seeds > 0]
    own = [study.name for study in results if study.plans and not study.has_reported]
    planned = plots.both_sides(estimates[estimates.study.isin(own)])
    title = "Success in distribution (left end) and from the mirror images of the same starts (right end)"
    drawn["home-field"] = Picture(title, plots.slopes(planned, runs, looks, _WIDTH), _means(planned))
    dots = plots.dots({SUCCESS: estimates}, runs, looks, _WIDTH)
    return {**drawn, "success": Picture(SUCCESS.title, dots, _means(estimates))}


def _progress_words(curves: pd.DataFrame) -> str:
    """How far each condition has come, in words."""
    ends = curves.groupby("condition", sort=False)[["env_steps", "way"]].max()
    return "; ".join(
        f"{condition}: {PERCENT.write(row.way)} of the way after {row.env_steps / 1e6:,.0f} million samples"
        for condition, row in ends.iterrows()
    )


def _means(estimates: pd.DataFrame) -> str:
    rows = (row for _, row in estimates.iterrows())
    return "; ".join(f"{row.label}: {SUCCESS.heading} {SUCCESS.of_seeds(row)}" for row in rows)


def summary(results: Sequence[Study], drawn: dict[str, Picture]) -> str:
    """The text between the marks of `README.md`: reported figures beside ours, and success by condition."""
    tables = ["\n".join(_table(of)) for of in (beside_reported(results), by_condition(results)) if len(of)]
    return "\n\n".join([*tables, _image("home-field", drawn, PICTURES)])


def by_condition(results: Sequence[Study]) -> pd.DataFrame:
    """Success by condition, of experiments with one task each of which nothing was reported."""
    rows = []
    for study in results:
        spec = study.experiment.spec if study.experiment else None
        if spec is None or spec.task is None or spec.sweep or study.has_reported:
            continue
        success, distance = (_spreads(study, quantity) for quantity in (SUCCESS, DISTANCE))
        for condition in study.conditions:
            cells = [success.get((condition, side), "-") for side in SIDES]
            cells.append(distance.get((condition, HOME), "-"))
            if seeds := study.counted(condition).seed.nunique():
                rows.append([study.name, condition, seeds, *cells])
    head = ["Task", "Method", "Seeds", "Success [%]", "Mirrored [%]", "Distance [m]"]
    return pd.DataFrame(rows, columns=head)


def _spreads(study: Study, quantity: Quantity) -> dict[tuple[str, str], str]:
    """A figure with its spread over seeds, by condition and side."""
    found = (row for _, row in study.estimates(quantity).iterrows() if row.seeds > 0)
    return {(row.condition, row.side): quantity.spread(row["mean"], row["std"]) for row in found}


def section(results: Sequence[Study], drawn: dict[str, Picture]) -> str:
    """The text between the marks of `results/README.md`: tables, verdicts, and what does not count."""
    parts = list[str]()
    for study in results:
        parts.append(_study_text(study))
        names = (study.name, f"{study.name}-learning")
        parts += [_image(name, drawn, "pictures") for name in names if name in drawn]
    return "\n\n".join([*parts, _image("success", drawn, "pictures")])


def _image(name: str, drawn: dict[str, Picture], folder: str) -> str:
    return f"![{drawn[name].title}]({folder}/{name}.svg)"


def _study_text(study: Study) -> str:
    question = f": {_plain(study.experiment.spec.description)}" if study.experiment else ""
    lines = [f"**`{_plain(study.name)}`**{question}", "", *_table(_with_effort(study))]
    if len(further := contents.further(study)):
        lines += ["", "The same policies on tasks they were not trained on:", "", *_table(further)]
    if study.verdicts:
        lines += ["", *_claim_lines(study.verdicts)]
    if notes := warnings(study):
        lines += ["", *(f"- Note: {_plain(note)}" for note in notes)]
    return "\n".join(lines)


def _claim_lines(verdicts: Sequence[Verdict]) -> list[str]:
    """The claims that something was measured for, and how many others there are."""
    known = [of for of in verdicts if of.figure is not None]
    lines = [
        f"- {_plain(of.claim.statement)}: **{verdict_words(of)}**, {_plain(evidence(of))}" for of in known
    ]
    rest = len(verdicts) - len(known)
    return [*lines, f"- Claims about runs that are missing: {rest}."] if rest else lines


def _with_effort(study: Study) -> pd.DataFrame:
    """Figures of the conditions that have runs, with what these took."""
    table = contents.comparison(study)
    table = table[[len(study.counted(condition)) > 0 for condition in table.Method]]
    return pd.DataFrame(
        [{**row, **_effort(study.counted(row["Method"]))} for row in table.to_dict("records")]
    )


def _effort(runs: pd.DataFrame) -> dict[str, str]:
    times = runs.training_seconds.agg(["min", "max"])
    columns = {
        "Iterations": [f"{iterations:,.0f}" for iterations in runs.iterations],
        "Steps a run": [f"{steps:,.0f}" for steps in runs.env_steps],
        "Training a run": [" to ".join(dict.fromkeys(times.map(contents.hours)))],
        "Hardware": [contents.hardware(of) for of in runs.provenance],
        "Commit": [contents.commit_text(of) for of in runs.provenance],
    }
    return {name: "; ".join(dict.fromkeys(values)) for name, values in columns.items()}


def _table(table: pd.DataFrame) -> list[str]:
    """A table in Markdown."""
    rows = [table.columns, ["---"] * len(table.columns), *table.itertuples(index=False)]
    return [f"| {' | '.join(_plain(str(cell)) for cell in row)} |" for row in rows]


def _plain(text: str) -> str:
    """A text that Markdown shows as it is, in one line."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")
