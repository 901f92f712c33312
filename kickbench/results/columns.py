"""Text in fixed columns: plain ASCII that reads the same in a terminal, a pipe, a log and an issue."""

from __future__ import annotations

from collections.abc import Sequence

from kickbench.errors import printable
from kickbench.results.statistics import mean_std_over_seeds

NOTHING = "-"
"""What stands for a figure that is not there."""

Row = tuple[str, ...]


def render_block(title: str, header: Row, blocks: Sequence[Sequence[Row]], groups: Row | None = ("",)) -> str:
    """A title, two lines of headings, and blocks of rows; nothing is ever cut off.

    Args:
        title: first line, if there is one.
        header: for each column its heading.
        blocks: rows with a cell a column. A block of several rows is set off from the next.
        groups: for each column the heading of a group of columns that begins there, or nothing; None: no such line.
    """
    blocks = [[tuple(map(_one_line, row)) for row in block] for block in blocks]
    body = [row for block in blocks for row in block]
    widths = [max(map(len, column)) for column in zip(header, *body, strict=True)]
    lines = [printable(title)] if title else []
    lines += [] if groups is None else [_group_line(groups, widths)]
    lines += [_line(header, widths), "-" * len(_line(header, widths))]
    for index, block in enumerate(blocks):
        lines += [_line(row, widths) for row in block]
        if len(block) > 1 and index < len(blocks) - 1:
            lines.append("")
    return "\n".join(lines)


def _one_line(cell: str) -> str:
    """A cell as a terminal can show it, whatever the names in it."""
    return " ".join(printable(cell).split("\n"))


def mean_and_spread(values: Sequence[float], decimals: int) -> tuple[str, str]:
    """Mean and sample standard deviation over seeds as text."""
    if not values:
        return NOTHING, NOTHING
    mean, std, _ = mean_std_over_seeds(values)
    return f"{mean:z.{decimals}f}", NOTHING if std is None else f"{std:.{decimals}f}"


def probability(p: float) -> str:
    """A p-value as text."""
    return "<0.001" if p < 0.001 else f"{p:.3f}"


def _group_line(groups: Row, widths: Sequence[int]) -> str:
    """The headings above the columns that they span."""
    line = ""
    for index, title in enumerate(groups):
        start = sum(widths[:index]) + 2 * index
        if title:
            line = line.ljust(start) + title
    return line


def _line(cells: Row, widths: Sequence[int]) -> str:
    """Cells side by side, two blanks apart: the name to the left, figures to the right."""
    padded = [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
    padded[0] = cells[0].ljust(widths[0])
    return "  ".join(padded).rstrip()


def non_finite_note(share: float) -> str:
    """What stands behind a figure of which some episodes became non-finite: ` (2.5 % non-finite)`; else nothing."""
    if not share > 0:
        return ""
    return f" ({'<0.1' if share < 0.001 else f'{100 * share:.1f}'} % non-finite)"
