"""The page: its parts put together from studies, and rendered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Literal

import pandas as pd

from kickbench.errors import require
from kickbench.report.breakdown import COORDINATES, binned_success
from kickbench.report.curves import QUANTITIES, SPLIT, curve_panels, has_quantity
from kickbench.report.figures.binned import draw_binned
from kickbench.report.figures.canvas import Picture
from kickbench.report.figures.dots import draw_dots
from kickbench.report.figures.equivariance import draw_errors, error_dots
from kickbench.report.figures.feet import draw_feet, kicks_of
from kickbench.report.figures.learning import draw_curves
from kickbench.report.figures.pitch import common_window, draw_pitch, resting_places
from kickbench.report.headline import Claimed, Headline, headline
from kickbench.report.palette import COLOURS, LEFT_FOOT, OTHER, RIGHT_FOOT, Colour, Look, looks_of
from kickbench.report.remarks import listed
from kickbench.report.spread import MEASURES, spreads
from kickbench.report.study import Note, Study
from kickbench.report.tables import (
    Table,
    asymmetry_table,
    comparison_table,
    further_table,
    kick_table,
    origins_table,
    provenance_table,
    reported_of,
    runs_table,
)


@dataclass(frozen=True)
class Key:
    """An entry of a legend: a colour, what it stands for, and a character that says the same without colour."""

    colour: Colour
    text: str
    mark: str


@dataclass(frozen=True)
class Figure:
    """Panels that belong together.

    Attributes:
        anchor: Its name in links, unique in the page.
        title: Title.
        text: What is to be seen.
        keys: Legend.
        pictures: Panels.
        absent: What is not there, and why: sentences.
        layout: How panels are placed: `wide`, `small` for three in a row, `pairs` for two.
        captions: Whether each panel's figures are printed below it.
    """

    anchor: str
    title: str
    text: str
    keys: tuple[Key, ...] = ()
    pictures: tuple[Picture, ...] = ()
    absent: tuple[str, ...] = ()
    layout: Literal["wide", "small", "pairs"] = "wide"
    captions: bool = False


@dataclass(frozen=True)
class Part:
    """The part of a page that is about one study."""

    anchor: str
    headline: Headline
    comparison: Table
    runs: Table
    asymmetry: Table | None
    origins: Table
    provenance: Table
    figures: tuple[Figure, ...]
    notes: tuple[Note, ...]
    problems: tuple[str, ...]
    further: Table | None = None
    kick: Table | None = None


def part_of(study: Study, claims: Sequence[Claimed], anchor: str, commit: str | None = None) -> Part:
    """The part of one study, all figures drawn.

    Args:
        study: The study.
        claims: Its claims with their verdicts.
        anchor: Unique in the page: letters, digits, dashes.
        commit: Commit of the code that makes the page, if it is known.
    """
    looks = looks_of(study.conditions.items())
    figures = (figure(study, looks, anchor) for figure in _FIGURES)
    return Part(
        anchor,
        headline(study, claims, commit),
        comparison_table(study),
        runs_table(study),
        asymmetry_table(study),
        origins_table(study),
        provenance_table(study),
        tuple(figures),
        study.notes,
        study.problems,
        further_table(study),
        kick_table(study),
    )


def render(title: str, parts: Sequence[Part], made_by: str) -> str:
    """The page as HTML; one file that needs no other, no network and no JavaScript.

    Args:
        title: Title of the page.
        parts: Its parts.
        made_by: Version and commit of the code that makes it.
    """
    jinja = require("jinja2", "a report", "report")
    here = files("kickbench.report")
    environment = jinja.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.undefined = jinja.StrictUndefined
    template = environment.from_string((here / "page.html.j2").read_text(encoding="utf-8"))
    style = (here / "page.css").read_text(encoding="utf-8")
    return template.render(title=title, parts=parts, made_by=made_by, style=style, colours=COLOURS)


def _arm_keys(study: Study, looks: Mapping[str, Look]) -> tuple[Key, ...]:
    marks = {"o": "●", "s": "■", "D": "◆", "^": "▲", "v": "▼", "P": "✚", "X": "✖", "h": "⬢"}
    return tuple(Key(looks[arm].colour, arm, marks[looks[arm].marker]) for arm in study.conditions)


def _results(study: Study, looks: Mapping[str, Look], anchor: str) -> Figure:
    pictures = []
    for measure in MEASURES:
        found = spreads(study.rows, study.conditions, measure, reported_of(study))
        if any(spread.seeds or spread.reported for spread in found):
            pictures.append(draw_dots(found, measure, looks, f"{anchor}-{measure.key.replace('_', '-')}"))
    unfinished = [arm for arm in study.conditions if study.counted(arm).empty]
    return Figure(
        f"{anchor}-dots",
        "Success and distance",
        "A mark a seed with its 95 % interval, hollow on the mirrored side; a coloured upright line is the mean over "
        "seeds, a black one what the thesis reports (for its own robot and task), with its standard deviation.",
        _arm_keys(study, looks),
        tuple(pictures),
        (f"Not measured: {', '.join(unfinished)}.",) if unfinished else (),
        layout="pairs",
    )


def _curves(study: Study, looks: Mapping[str, Look], anchor: str) -> Figure:
    pictures, absent, window = [], list(_without(study, study.curves, "training curve (progress.csv)")), 1
    for quantity in QUANTITIES:
        is_ending = quantity.column.startswith("termination/")
        if study.curves and is_ending and not has_quantity(study.curves, quantity):
            absent.append(f"{quantity.title}: this task has no such ending.")
        for number, panel in enumerate(curve_panels(study.curves, quantity)):
            window = max(window, panel.window)
            pictures.append(draw_curves(panel, looks, f"{anchor}-{quantity.key}-{number}"))
    return Figure(
        f"{anchor}-curves",
        "Learning curves",
        f"As the thesis' (4.3.1) in two panels: up to iteration {SPLIT}, and from there on. Thick: mean over seeds, as "
        "far as all of them have come; thin: single seeds. Rates are of episodes in training, with exploration noise; "
        f"every point is a moving mean over at most {window} iterations.",
        _arm_keys(study, looks),
        tuple(pictures),
        tuple(absent),
        layout="pairs"
        if len(pictures) > len({picture.title.split(",")[0] for picture in pictures})
        else "wide",
    )


def _pitch(study: Study, looks: Mapping[str, Look], anchor: str) -> Figure:
    found = resting_places(study.episodes)
    window = common_window(found) if found else None
    pictures = [
        draw_pitch(rest, window, looks[rest.arm], f"{anchor}-pitch-{number}")
        for number, rest in enumerate(found)
        if window is not None
    ]
    return Figure(
        f"{anchor}-pitch",
        "Where the balls stopped",
        "The pitch from above: the robot stands in the triangle and looks up. In colour: at the target; grey: not.",
        (
            *(Key(looks[arm].colour, f"{arm}, at the target", "●") for arm in study.conditions),
            Key(OTHER, "not at the target", "●"),
        ),
        tuple(pictures),
        _without(study, study.episodes, "table of episodes (episodes.csv)"),
        layout="small",
        captions=True,
    )


def _breakdown(study: Study, looks: Mapping[str, Look], anchor: str) -> Figure:
    pictures = []
    for coordinate in COORDINATES:
        found = binned_success(study.episodes, coordinate)
        if found:
            pictures.append(draw_binned(found, coordinate, looks, f"{anchor}-by-{coordinate.key}"))
    return Figure(
        f"{anchor}-targets",
        "Success by target",
        "Solid: in distribution; broken and hollow: mirrored. Bands are 95 % Wilson intervals of the pooled episodes; "
        "bins with fewer than 20 episodes are left out.",
        _arm_keys(study, looks),
        tuple(pictures),
        _without(study, study.episodes, "table of episodes (episodes.csv)"),
        layout="pairs",
    )


def _feet(study: Study, looks: Mapping[str, Look], anchor: str) -> Figure:
    kicks = (kicks_of(arm, *run) for arm, runs in study.episodes.items() for run in runs)
    pictures = [draw_feet(kicked, f"{anchor}-feet-{number}") for number, kicked in enumerate(kicks)]
    keys = (Key(LEFT_FOOT, "left foot", "■"), Key(RIGHT_FOOT, "right foot", "■"), Key(OTHER, "no foot", "■"))
    return Figure(
        f"{anchor}-feet",
        "Which foot kicks",
        "Where the ball lay, in tiles, each divided by what touched it first; both sides of the evaluation. A policy "
        "with a favourite leg is of one colour, a symmetric one is its own mirror image with the colours swapped.",
        keys,
        tuple(pictures),
        _without(study, study.episodes, "table of episodes (episodes.csv)"),
        layout="small",
        captions=True,
    )


def _errors(study: Study, looks: Mapping[str, Look], anchor: str) -> Figure:
    dots = error_dots(study.counted())
    silent = study.runs[~study.runs.counted | study.runs["equivariance/relative"].isna()]
    return Figure(
        f"{anchor}-error",
        "Equivariance error",
        "RMS of π(ρo) − ρπ(o) over visited states, relative to that of the actions. The broken line, √2, is where the "
        "two have nothing in common.",
        _arm_keys(study, looks),
        (draw_errors(dots, looks, f"{anchor}-error-dots"),) if dots else (),
        (f"Not measured: {_names(silent)}.",) if len(silent) else (),
        layout="pairs",
    )


_FIGURES = (_results, _curves, _pitch, _breakdown, _feet, _errors)


def _without(study: Study, found: Mapping[str, Sequence[tuple[int, object]]], words: str) -> tuple[str, ...]:
    """Names the runs that lack a file."""
    told = {(arm, seed) for arm, runs in found.items() for seed, _ in runs}
    keys = zip(study.runs.condition, study.runs.seed, strict=True)
    silent = study.runs[[key not in told for key in keys]]
    return (f"Not measured, no {words}: {_names(silent)}.",) if len(silent) else ()


def _names(runs: pd.DataFrame) -> str:
    arms: dict[str, list[int]] = {}
    for arm, seed in zip(runs.condition, runs.seed, strict=True):
        arms.setdefault(arm, []).append(seed)
    return listed(arms)


def anchors(studies: Sequence[Study]) -> Iterator[str]:
    """A name for every study that fits in a link."""
    yield from (f"part{number}" for number in range(1, len(studies) + 1))
