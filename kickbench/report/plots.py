"""The figures: functions from tables of figures to a matplotlib figure, to be called within `style()`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from kickbench.report.style import INK, OTHER, Look, subplots
from kickbench.results.quantities import Quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Looks = Mapping[Any, Look]
"""The look of each condition."""

_LEAST_WINDOW, _POINTS = 9, 300
_OUTSIDE = 0.002
"""Share of the balls, at each edge of the pitch, that may be left out so that the others are seen."""
QUANTITIES = {
    "mean_return": "Return of an episode",
    "evaluation/in_distribution": "Success in evaluation",
    "evaluation/mirrored": "Success in evaluation, mirrored",
    "termination/target_hit": "Hit",
    "termination/target_missed": "Missed",
    "termination/double_touch": "Double touch",
    "termination/time_out": "Time out",
    "termination/fell_down": "Fall down",
    "termination/fell_over": "Fell over",
}
"""Columns of `progress.csv` that the thesis shows, in its order (Figs. 4.5 to 4.7); and evaluations."""


def dots(found: Mapping[Quantity, pd.DataFrame], runs: pd.DataFrame, looks: Looks, width: float) -> Figure:
    """A row per condition and side: seeds with their intervals, their mean, and in black what was reported.

    Args:
        found: Of each figure the rows of `Study.estimates`.
        runs: Rows of the runs, with the same labels.
        looks: The look of each condition.
        width: CSS pixels.
    """
    count = max(map(len, found.values()))
    figure, (panels,) = subplots(width, 60 + 30 * count, 1, len(found), sharey=True)
    for axes, (quantity, estimates) in zip(panels, found.items(), strict=True):
        for y, (_, row) in enumerate(estimates.iterrows()):
            _draw_seeds(axes, y, runs[runs.label == row.label], quantity, looks[row.condition])
            _draw_mean(axes, y, row, quantity, looks[row.condition])
        axes.set_xlabel(f"{quantity.title.lower()}, {quantity.unit.name}")
        axes.set_xlim((-2, 102) if quantity.unit.name == "%" else (0, None))
        axes.set_yticks(range(len(estimates)), list(estimates.label))
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.grid(visible=False, axis="y")
        axes.set_ylim(count - 0.4, -0.6)
    return figure


def _draw_seeds(axes: Any, y: float, runs: pd.DataFrame, quantity: Quantity, look: Look) -> None:
    """Seeds one below the other within a row, hollow on the mirrored side."""
    runs = runs[runs[quantity.column].notna()]
    names = (quantity.column, f"{quantity.ends}_low", f"{quantity.ends}_high")
    value, low, high = (quantity.unit.factor * runs[name] for name in names)
    places = y + (np.linspace(-0.22, 0.22, len(runs)) if len(runs) > 1 else np.zeros(len(runs)))
    face = "white" if (runs.side == "mirrored").any() else look.colour
    errors = [value - low, high - value]
    axes.errorbar(
        value, places, xerr=errors, fmt=look.marker, color=look.colour, mfc=face, ms=4.5, elinewidth=1
    )


def _draw_mean(axes: Any, y: float, row: pd.Series, quantity: Quantity, look: Look) -> None:
    if row.seeds > 1:
        axes.vlines(quantity.unit.factor * row["mean"], y - 0.3, y + 0.3, color=look.colour)
    if pd.notna(row.reported):
        std = None if pd.isna(row.reported_std) else quantity.unit.factor * row.reported_std
        axes.errorbar(
            quantity.unit.factor * row.reported, y, xerr=std, fmt="|", color=INK, ms=18, elinewidth=1
        )


def both_sides(estimates: pd.DataFrame) -> pd.DataFrame:
    """The rows of conditions that were measured in distribution and mirrored."""
    known = estimates[estimates.seeds > 0]
    return known[known.groupby(["study", "condition"]).side.transform("size") == 2]


def slopes(estimates: pd.DataFrame, runs: pd.DataFrame, looks: Looks, width: float) -> Figure:
    """What conditions lose on the mirrored side: thin lines are seeds, thick ones means with 95 % intervals.

    Args:
        estimates: Rows of `both_sides`, of success.
        runs: Rows of the runs.
        looks: The look of each condition.
        width: CSS pixels.
    """
    figure, ((axes,),) = subplots(width, 260)
    place, ticks = 0.0, {}
    for study, of_study in estimates.groupby("study", sort=False):
        middle = place + (of_study.condition.nunique() - 1) / 2
        axes.text(middle, 1.02, study, ha="center", va="bottom", transform=axes.get_xaxis_transform())
        for condition, sides in of_study.groupby("condition", sort=False):
            own = runs[(runs.study == study) & (runs.condition == condition)]
            _draw_slope(axes, place, sides, own, looks[condition])
            ticks[place] = str(condition).replace("_", "_\n")
            place += 1.0
        place += 0.4
    axes.set_xticks(list(ticks), list(ticks.values()))
    axes.tick_params(axis="x", length=0)
    axes.grid(visible=False, axis="x")
    axes.set(ylim=(-2, 102), ylabel="success, %")
    return figure


def _draw_slope(axes: Any, place: float, sides: pd.DataFrame, runs: pd.DataFrame, look: Look) -> None:
    ends, means = [place - 0.22, place + 0.22], 100 * sides["mean"].to_numpy()
    by_seed = 100 * runs.pivot(index="side", columns="path", values="success_rate").dropna(axis=1)
    axes.plot(ends, by_seed.loc[list(sides.side)], color=look.colour, linewidth=0.9, alpha=0.45)
    axes.plot(ends, means, color=look.colour, linewidth=2.4, zorder=3)
    axes.vlines(ends, 100 * sides.low, 100 * sides.high, color=INK, linewidth=1.0, zorder=4)
    for x, mean, face in zip(ends, means, (look.colour, "white"), strict=True):
        axes.plot(x, mean, look.marker, color=look.colour, ms=7, mfc=face, zorder=5)


def over_setting(estimates: pd.DataFrame, looks: Looks, width: float) -> Figure:
    """Success over a setting that was swept, a line per condition: means over seeds, with 95 % intervals.

    Args:
        estimates: Rows of `Study.swept`, of success.
        looks: The look of each condition of the experiment's file.
        width: CSS pixels.
    """
    figure, ((axes,),) = subplots(width, 300)
    values = sorted(estimates.value.unique())
    # Side by side, so that intervals do not hide each other.
    step = 0.012 * (values[-1] - values[0])
    for number, (condition, own) in enumerate(estimates.sort_values("value").groupby("of", sort=False)):
        look, mean = looks[condition], 100 * own["mean"]
        ends = [mean - 100 * own.low, 100 * own.high - mean]
        places = own.value + step * (number - (len(looks) - 1) / 2)
        axes.errorbar(
            places, mean, yerr=ends, fmt=look.marker, linestyle=look.line, color=look.colour, label=condition
        )
    axes.set(xlabel=estimates.setting.iloc[0], ylabel="success, %", ylim=(-2, 102), xticks=values)
    figure.legend(loc="outside upper left", ncols=4)
    return figure


def learning_curves(curves: pd.DataFrame, looks: Looks) -> Figure:
    """A row per quantity: over the iterations, and over the samples.

    Args:
        curves: Rows of `Study.curves`.
        looks: The look of each condition.
    """
    # A task without falls has no falls to show.
    shown = [name for name in QUANTITIES if name in curves]
    xs = [x for x in ("iteration", "env_steps") if x in curves]
    figure, panels = subplots(400 * len(xs), 40 + 170 * len(shown), len(shown), len(xs))
    for row, column in zip(panels, shown, strict=True):
        for axes, x in zip(row, xs, strict=True):
            _draw_curves(axes, curves, x, column, looks)
            axes.set(title=QUANTITIES[column], xlabel=x.replace("_", " "))
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return figure


def over_samples(curves: pd.DataFrame, looks: Looks, width: float) -> Figure:
    """Success in exploration, and how far a curriculum has come to the whole task, over the samples.

    Args:
        curves: Rows of `whole_trainings`.
        looks: The look of each condition.
        width: CSS pixels.
    """
    figure, (panels,) = subplots(width, 260, 1, 2)
    curves = curves.assign(samples=curves.env_steps / 1e6)
    shown = {"success_rate": "success in exploration, %", "way": "way to the whole task, %"}
    for axes, (column, title) in zip(panels, shown.items(), strict=True):
        _draw_curves(axes, curves.assign(**{column: 100 * curves[column]}), "samples", column, looks)
        axes.set(xlabel="samples, million", ylabel=title, xlim=(0, None), ylim=(-2, 102))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return figure


def smoothed(curves: pd.DataFrame, column: str) -> pd.DataFrame:
    """Centred moving means of the runs of a condition over about a hundredth of the training, NaN left out.

    Args:
        curves: Rows of `Study.curves` of one condition.
        column: What is shown.

    Returns:
        A row per iteration, thinned; a column per run, NaN from where it ends.
    """
    runs = curves.pivot(index="iteration", columns="path", values=column)
    window = max(_LEAST_WINDOW, len(runs) // 100) | 1
    means = runs.rolling(window, center=True, min_periods=1).mean().where(runs.bfill().notna())
    return means.iloc[:: max(1, len(runs) // _POINTS)]


def _draw_curves(axes: Any, curves: pd.DataFrame, x: str, column: str, looks: Looks) -> None:
    """Thin lines are seeds; the thick one is their mean, as far as all of them have come."""
    for condition, own in curves.groupby("condition", sort=False):
        runs, look, places = smoothed(own, column), looks[condition], own.groupby("iteration")[x].max()
        if len(runs.columns) > 1:
            axes.plot(places[runs.index], runs, color=look.colour, linewidth=0.7, alpha=0.55)
        mean = runs.dropna().mean(axis=1)
        style = {"color": look.colour, "linewidth": 2.0, "linestyle": look.line}
        axes.plot(places[mean.index], mean, label=str(condition), **style)


def resting_places(episodes: pd.DataFrame, looks: Looks) -> Figure:
    """The pitch from above, a panel per condition and side: where balls came to rest.

    Args:
        episodes: Rows of `Study.episodes`.
        looks: The look of each condition.
    """
    groups = list(episodes.groupby(["condition", "side"], sort=False))
    columns = episodes.side.nunique()
    rows = -(-len(groups) // columns)
    figure, panels = subplots(330 * columns, 280 * rows, rows, columns, sharex=True, sharey=True)
    for axes, ((condition, side), own) in zip(panels.flat, groups, strict=False):
        own = own.sort_values("success", kind="stable")
        colours = np.where(own.success, looks[condition].colour, OTHER)
        size = float(np.clip(6000 / len(own), 0.6, 7.0))
        axes.scatter(
            own.final_ball_y, own.final_ball_x, size, colours, alpha=0.6, linewidth=0, rasterized=True
        )
        axes.plot(0.0, 0.0, "^", ms=8, color=INK)
        axes.set(title=f"{condition}, {str(side).replace('_', ' ')}", aspect="equal")
    low, high = np.quantile(episodes.final_ball_x, [_OUTSIDE, 1 - _OUTSIDE])
    reach = 1.05 * max(np.quantile(episodes.final_ball_y.abs(), 1 - _OUTSIDE), 0.1)
    # As wide to the left as to the right: the eye compares the two.
    panels[0, 0].set(xlim=(reach, -reach), ylim=(min(low, 0) - 0.2, max(high, 0) + 0.2))
    figure.supxlabel("y, m (left)")
    figure.supylabel("x, m (forward)")
    return figure


def twin_distances(runs: pd.DataFrame, looks: Looks) -> Figure:
    """Distance of episodes from the mirror images of their twins over time, a line per run.

    Thick lines are medians, thin broken ones 90 % quantiles.

    Args:
        runs: Rows of the runs that have it.
        looks: The look of each condition.
    """
    figure, (panels,) = subplots(760, 280, 1, 2)
    for axes, of, unit in zip(panels, ("ball", "joints"), ("m", "rad"), strict=True):
        for condition, own in runs.groupby("condition", sort=False):
            for number, twins in enumerate(own.twins):
                values, look = pd.DataFrame(list(twins)).clip(lower=1e-9), looks[condition]
                label = str(condition) if number == 0 else None
                axes.plot(
                    values.time, values[f"{of}_median"], color=look.colour, marker=look.marker, label=label
                )
                axes.plot(values.time, values[f"{of}_q90"], "--", color=look.colour, linewidth=0.9)
        axes.set(xscale="log", yscale="log", xlabel="time, s", ylabel=f"{of}, {unit}")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper")
    return figure
