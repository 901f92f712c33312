"""The page: whole, self-contained, honest about what is not there, safe with any name."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest

from kickbench.cli import main
from kickbench.results.identity import identity_of
from kickbench.results.integrity import seal
from kickbench.results.metrics import load_metrics
from kickbench.trials.experiment import load_experiment
from kickbench.trials.trial import load_trial

from ..made_up import write_metrics
from .conftest import Folder

ROOT = Path(__file__).parents[2]
REPORTED = ROOT / "results/reported/mini_home_field.yaml"
VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """Tags, attributes and words of a page; elements must be closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def attributes(self, name: str) -> list[str]:
        return [attributes[name] or "" for _, attributes in self.tags if name in attributes]


def page_of(folder: Path, *options: str) -> tuple[Page, str]:
    out = folder.parent / "page.html"
    assert main(["report", str(folder), "-o", str(out), *options]) == 0
    text = out.read_text()
    return Page(text), text


@pytest.fixture(scope="module")
def whole(make_folder) -> tuple[Page, str]:
    """The page of three methods, one of them with two seeds."""
    folder = make_folder()
    for method, seed in (("baseline", 0), ("baseline", 1), ("augmentation", 0), ("equivariant", 0)):
        folder.add(method, seed)
    return page_of(folder.path)


def test_a_page_is_well_formed_and_needs_nothing_else(whole):
    page, text = whole
    tags = {tag for tag, _ in page.tags}
    assert not tags & {"script", "link", "iframe", "object", "embed"}
    assert all(reference.startswith("#") for reference in page.attributes("href"))
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.attributes("src"))
    assert not re.search(r"@import|url\(", text)
    assert not [name for _, attributes in page.tags for name in attributes if name.startswith("on")]
    assert len(text) < 3_000_000


def test_links_lead_somewhere(folder):
    folder.add("baseline", curves=None, table=False)
    Folder(folder.path.parent / "other", "another_task").add("baseline", curves=None, table=False)
    page, _ = page_of(folder.path.parent)
    names = page.attributes("id")
    assert len(names) == len(set(names)) == 2
    assert {value.removeprefix("#") for value in page.attributes("href")} == set(names)


def test_every_picture_has_a_name_and_every_table_headings(whole):
    page, _ = whole
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 4
    for attributes in pictures:
        assert attributes["alt"]
        ElementTree.fromstring(base64.b64decode((attributes["src"] or "").partition(",")[2]))
    assert [attributes["scope"] for tag, attributes in page.tags if tag == "th"]


def test_every_figure_is_there(whole):
    page, _ = whole
    for title in (
        "Success and distance", "Success on both sides", "Learning curves", "Where the balls stopped",
        "asymmetry: mini_home_field", "Provenance",
    ):  # fmt: skip
        assert title in page.text
    assert "Symmetry over time" not in page.text, "there are no data for it"


def test_figures_stand_beside_what_they_rest_on(whole):
    page, _ = whole
    one = "66.7 (95 % [54.1, 77.3], 1 seed)"
    assert f"equivariant in distribution {one}" in page.text
    assert f"equivariant mirrored {one}" in page.text
    assert "A Processor, 2 threads" in page.text
    assert "2,764,800" in page.text
    assert "task: mini_home_field: kick" in page.text
    assert "1.75" in page.text
    assert "-14.0" in page.text, "the bias in degrees: a third of the balls is launched 0.75 rad to the right"
    assert "run by other code than this page's, commit 0123456789".lower() in page.text.lower()


def test_results_alone_make_a_page_that_says_what_is_missing(folder):
    folder.add("baseline", curves=None, table=False)
    page, _ = page_of(folder.path)
    for file in ("progress.csv", "episodes.csv"):
        assert f"Not in every figure, it has no {file}: baseline seed 0." in page.text
    assert "66.7" in page.text


def test_an_experiment_names_missing_unfinished_and_smaller_runs(folder):
    folder.add("baseline", 0, curves=None, table=False)
    folder.add("equivariant", 0, curves=None, table=False, iterations=45, scale=0.1)
    unfinished = folder.path / "augmentation" / "seed2"
    unfinished.mkdir(parents=True)
    (unfinished / "progress.csv").write_text("iteration,mean_return\n0,1\n1,2\n")
    page, _ = page_of(folder.path, "--experiment", str(REPORTED))
    assert "2 of 25 runs are finished." in page.text
    assert "Unfinished: 2 of 390 iterations: augmentation seed 2." in page.text
    assert "Scaled to 0.1, 45 of 390 iterations, another identity: equiv" in page.text
    assert "another identity: baseline seed 0." in page.text
    assert (
        "Missing: baseline seeds 1, 2, 3 and 4, augmentation seeds 0, 1, 3 and 4, equivariant seeds 1, 2, 3 and 4, "
        "augmentation_stock seeds 0, 1, 2, 3 and 4, equivariant_matched seeds 0, 1, 2, 3 and 4." in page.text
    )
    assert re.search(r"Of (\d+) claims: \1 without enough data to say\.", page.text)
    assert "The baseline loses at least 15 points of success on the mirrored side" in page.text
    assert "Learning curves Over" in page.text, "the unfinished run's"


def test_a_run_in_its_first_iteration_has_no_curve_yet(folder):
    begun = folder.path / "augmentation" / "seed0"
    begun.mkdir(parents=True)
    (begun / "progress.csv").touch()
    page, _ = page_of(folder.path)
    assert "0 of 1 runs are finished." in page.text
    assert "Learning curves" not in page.text


def test_measured_results_of_the_repository_are_judged(tmp_path):
    measured = ROOT / "results/measured/mini_home_field"
    out = tmp_path / "page.html"
    assert main(["report", str(measured), "--experiment", str(REPORTED), "-o", str(out)]) == 0
    text = Page(out.read_text()).text
    assert re.search(r"Of 17 claims: \d+ met, (\d+ not met, )?\d+ without enough data to say\.", text)


def test_reported_figures_stand_beside_measured_ones(tmp_path):
    reported = ROOT / "results/reported/home_field.yaml"
    empty = tmp_path / "home_field"
    empty.mkdir()
    page, _ = page_of(empty, "--experiment", str(reported))
    assert "Reported and measured" in page.text
    assert "55.58" not in page.text  # one decimal, as everywhere
    for figure in ("55.6", "15.3", "3.416", "not measured", "0 of 3 runs are finished."):
        assert figure in page.text


def test_a_damaged_result_is_told_and_not_shown(folder):
    run = folder.add("baseline", curves=None)
    (run / "metrics.json").write_text('{"schema_version": 1}')
    seal(run)
    page, _ = page_of(folder.path, "--experiment", str(REPORTED))
    assert "Damaged (metrics.json: no valid metrics: task: Field required; " in page.text
    assert re.search(r"Of (\d+) claims: \1 without enough data to say\.", page.text)


def test_a_run_that_the_experiment_does_not_plan_is_named(folder):
    folder.add("baseline", 0, curves=None, table=False)
    folder.add("baseline", 7, curves=None, table=False)
    page, _ = page_of(folder.path, "--experiment", str(REPORTED))
    assert "baseline/seed7: not planned by mini_home_field" in page.text


def test_a_mean_says_of_how_many_seeds_it_is(folder):
    experiment = load_experiment(REPORTED)
    arm = experiment.conditions["baseline"]
    identity = identity_of(load_trial(arm.task.document.file, arm.method.document.file, arm.settings))
    for seed in range(3):
        folder.add("baseline", seed, identity=identity if seed else None, curves=None, table=False)
    page, _ = page_of(folder.path, "--experiment", str(REPORTED))
    assert "3 of 25 runs are finished." in page.text
    two = "66.7 ± 0.0 (95 % [66.7, 66.7], 2 seeds)"
    assert f"baseline in distribution {two}" in page.text
    assert f"baseline mirrored {two}" in page.text
    assert "another identity: baseline seed 0." in page.text


def test_episodes_that_became_non_finite_are_told(folder):
    run = folder.add("baseline", curves=None, table=False)
    metrics = load_metrics(run / "metrics.json")
    home = metrics.evaluation.in_distribution.model_copy(update={"terminations": {"non_finite": 1.0}})
    evaluation = metrics.evaluation.model_copy(update={"in_distribution": home})
    write_metrics(run / "metrics.json", metrics.model_copy(update={"evaluation": evaluation}))
    seal(run)
    page, _ = page_of(folder.path)
    assert "100.0 % of its episodes became non-finite: baseline seed 0." in page.text


def test_names_cannot_break_out_of_the_page(folder):
    run = folder.add("baseline")
    metrics = json.loads((run / "metrics.json").read_text())
    metrics["method"], metrics["task"] = "<script>alert(1)</script>", "a & b <i>"
    (run / "metrics.json").write_text(json.dumps(metrics))
    seal(run)
    page, _ = page_of(folder.path)
    assert not {tag for tag, _ in page.tags} & {"script", "i"}
    assert "<script>alert(1)</script>" in page.text


def test_a_note_beside_the_runs_is_pointed_at(folder):
    (folder.add("baseline") / "README.md").write_text("mine")
    page, _ = page_of(folder.path)
    assert "baseline/seed0/README.md says more of these runs." in page.text


def test_the_same_runs_make_the_same_page(folder):
    folder.add("baseline", curves=None)
    assert page_of(folder.path)[1] == page_of(folder.path)[1]


def test_a_single_run_has_a_page(folder):
    run = folder.add("baseline", curves=None, table=False)
    assert main(["report", str(run)]) == 0
    assert "baseline in distribution 66.7" in Page((run / "report.html").read_text()).text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["report", "nowhere"], "nowhere: no such folder"),
        (["report", "."], "no run in it, finished or not"),
        (["report"], "expected a folder of runs"),
        (["report", ".", "--experiment", "nothing.yaml"], "nothing.yaml"),
        (["report", ".", "--readme"], "--readme takes"),
    ],
)
def test_wrong_use_is_an_error_and_writes_nothing(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("module", ["jinja2", "matplotlib.figure"])
def test_a_missing_library_is_named_with_what_installs_it(folder, monkeypatch, capsys, module):
    import kickbench.errors as extra

    real = extra.import_module

    def import_module(name):
        if name == module:
            raise ModuleNotFoundError(name)
        return real(name)

    monkeypatch.setattr(extra, "import_module", import_module)
    folder.add("baseline", curves=None, table=False)
    assert main(["report", str(folder.path)]) == 2
    assert "kickbench[report]" in capsys.readouterr().err
    assert not (folder.path / "report.html").exists()
