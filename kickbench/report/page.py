"""`kickbench report DIR`: from a folder of runs to one HTML file without JavaScript that needs no other."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kickbench import __version__
from kickbench.errors import printable, require
from kickbench.report import contents, plots
from kickbench.report.contents import evidence, outcome, verdict_words, warnings
from kickbench.report.study import Study, studies
from kickbench.report.style import Picture, looks_of, style
from kickbench.results.atomic import atomic_write_text
from kickbench.results.frame import HOME
from kickbench.results.provenance import code_state
from kickbench.results.quantities import DISTANCE, SUCCESS
from kickbench.results.tables import render_table
from kickbench.trials.experiment import LoadedExperiment

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH = 760


def write_report(root: Path, out: Path, experiment: LoadedExperiment | None = None) -> None:
    """Writes the page of a folder of runs.

    Args:
        root: The folder.
        out: File to write.
        experiment: What should be there; default: whatever is there.

    Raises:
        KickbenchError: There is no run, or a library is missing.
    """
    jinja = require("jinja2", "a report", "report")
    found, (commit, dirty) = studies(root, experiment), code_state()
    with style():
        parts = [_part(study, commit) for study in found]
    title = f"kickbench: {found[0].name if len(found) == 1 else root.resolve().name}"
    at = f" at commit {commit[:10]}{' with uncommitted changes' if dirty else ''}" if commit else ""
    environment = jinja.Environment(
        loader=jinja.FileSystemLoader(Path(__file__).parent), undefined=jinja.StrictUndefined, autoescape=True
    )
    text = environment.get_template("page.html.j2").render(
        title=title, parts=parts, made_by=f"Page made by kickbench {__version__}{at}."
    )
    atomic_write_text(out, printable(text))


def _part(study: Study, commit: str | None) -> dict[str, Any]:
    """What the template prints of a study."""
    return {
        "study": study,
        "outcome": outcome(study),
        "warnings": warnings(study, commit),
        "claims": [(verdict, verdict_words(verdict), evidence(verdict)) for verdict in study.verdicts],
        "comparison": contents.comparison(study),
        "pictures": {name: _address(figure) for name, figure in _figures(study).items()},
        "texts": [render_table(study.rows), render_table(study.rows[study.rows.counted], "kick")],
        "tables": {"On further tasks": contents.further(study), "Provenance": contents.provenance(study)},
    }


def _figures(study: Study) -> dict[str, Figure]:
    """The figures that there are data for, by the names that the template calls them."""
    looks, runs, episodes = looks_of(study.conditions), study.measured, study.episodes
    found = {measure: study.estimates(measure) for measure in (SUCCESS, DISTANCE)}
    drawn = {}
    if any(map(len, found.values())):
        drawn["dots"] = plots.dots(found, runs, looks, _WIDTH)
    if len(both := plots.both_sides(found[SUCCESS])):
        drawn["slopes"] = plots.slopes(both, runs, looks, _WIDTH)
    if len(swept := study.swept(SUCCESS)):
        drawn["sweep"] = plots.over_setting(swept, looks_of(swept.of), _WIDTH)
    if len(study.curves):
        drawn["curves"] = plots.learning_curves(study.curves, looks)
    if len(episodes):
        drawn["pitch"] = plots.resting_places(episodes, looks)
    if len(known := runs[(runs.side == HOME) & runs.twins.notna()]):
        drawn["twins"] = plots.twin_distances(known, looks)
    return drawn


def _address(figure: Figure) -> str:
    """A figure as an image within the page: names in one SVG cannot meet those of another."""
    return f"data:image/svg+xml;base64,{base64.b64encode(Picture('', figure).svg().encode()).decode()}"
