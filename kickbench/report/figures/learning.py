"""Learning curves: thick lines are means over seeds, thin ones single seeds."""

from __future__ import annotations

from collections.abc import Mapping

from kickbench.report.curves import CurvePanel, Line
from kickbench.report.figures.canvas import Panel, Picture
from kickbench.report.palette import Look

_WIDTH, _HEIGHT = 330, 200


def draw_curves(panel: CurvePanel, looks: Mapping[str, Look], name: str, *, themed: bool = True) -> Picture:
    """One panel of one quantity.

    Args:
        panel: What to draw.
        looks: The look of each arm.
        name: Unique in the page.
        themed: See `Panel.picture`.
    """
    scale = 100.0 if panel.quantity.share else 1.0
    canvas = Panel(_WIDTH, _HEIGHT)
    axes = canvas.axes
    for arm in panel.arms:
        look = looks[arm.arm]
        colour = look.colour.light
        dash = (0, look.dash) if look.dash else "-"
        for _, line in arm.seeds if arm.mean is not None else ():
            axes.plot(line.iteration, scale * line.value, color=colour, linewidth=0.7, alpha=0.55)
        whole = arm.mean if arm.mean is not None else arm.seeds[0][1]
        axes.plot(whole.iteration, scale * whole.value, color=colour, linewidth=2.0, linestyle=dash)
    axes.set_xlim(panel.first, max(panel.last, panel.first + 1))
    if panel.quantity.share:
        axes.set_ylim(bottom=0.0)
        axes.set_ylim(top=max(axes.get_ylim()[1], 1.0))
    axes.set_xlabel("training iteration")
    axes.set_ylabel("% of episodes" if panel.quantity.share else "return")
    return canvas.picture(name, _title(panel), _text(panel, scale), themed=themed)


def _title(panel: CurvePanel) -> str:
    return f"{panel.quantity.title}, iterations {panel.first:,} to {panel.last:,}"


def _text(panel: CurvePanel, scale: float) -> str:
    unit = " %" if panel.quantity.share else ""
    parts = []
    for arm in panel.arms:
        seeds = "; ".join(f"seed {seed} {_ends(line, scale, unit)}" for seed, line in arm.seeds)
        mean = (
            f"mean {_ends(arm.mean, scale, unit)}; " if arm.mean is not None and arm.mean.value.size else ""
        )
        parts.append(f"{arm.arm}: {mean}{seeds}.")
    return " ".join(parts)


def _ends(line: Line, scale: float, unit: str) -> str:
    first, last = scale * line.value[0], scale * line.value[-1]
    return (
        f"from {first:.4g}{unit} at iteration {line.iteration[0]} to {last:.4g}{unit} at {line.iteration[-1]}"
    )
