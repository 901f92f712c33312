from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.config.shipped import find, find_method
from kickbench.config.yamlio import load_document
from kickbench.envs.catalog import catalog
from kickbench.errors import KickbenchError
from kickbench.trials.validate import KINDS

from .. import support

ROOT = Path(__file__).parents[2]
HEAVY = ("torch", "mujoco", "warp", "rsl_rl", "tensordict", "numpy", "pydantic")
SHIPPED = {
    "task": sorted(ROOT.glob("tasks/*.yaml")),
    "method": sorted(ROOT.glob("methods/[!r]*/*.yaml")),
    "representations": sorted(ROOT.glob("methods/representations/*.yaml")),
    "robot": sorted(ROOT.glob("assets/*/*.yaml")),
    "experiment": sorted(ROOT.glob("results/reported/*.yaml")),
}
SHIPPED_TASKS = sorted(ROOT.glob("tasks/**/*.yaml"), key=lambda path: (len(path.parts), path))


def test_a_word_that_is_none_of_the_choices_is_one_plain_line(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["terms", "ball_height"])
    error = capsys.readouterr().err
    assert error.startswith(
        "kickbench terms: Invalid value for '[KIND]': 'ball_height' is not one of 'observations', 'rewards'"
    )
    assert error.count("\n") == 1


@pytest.fixture
def printed(capsys):
    """Calls the command line, which must succeed; returns what it printed."""

    return partial(support.printed, capsys)


def modules_after(code: str) -> set[str]:
    """Top-level modules that a fresh interpreter has after running some code."""
    report = "; import sys, json; print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    done = subprocess.run(
        [sys.executable, "-c", code + report], capture_output=True, text=True, cwd=ROOT, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


# Imports


def test_importing_the_package_imports_nothing_heavy():
    assert not modules_after("import kickbench") & set(HEAVY)


@pytest.mark.parametrize("argv", [["--help"], ["run", "--help"], ["--version"]], ids=" ".join)
def test_help_imports_nothing_heavy(argv):
    code = f"import contextlib, kickbench.cli\nwith contextlib.suppress(SystemExit): kickbench.cli.main({argv})\npass"
    assert not modules_after(code) & (set(HEAVY) - {"pydantic"}), "typer reads arguments by pydantic"


def test_reading_specs_imports_no_physics_and_no_learning():
    rooms = ("config.load", "config.explain", "symmetry.field_table", "symmetry.mirror")
    code = "; ".join(f"import kickbench.{room}" for room in rooms)
    assert not modules_after(code) & {"torch", "mujoco", "warp", "rsl_rl", "tensordict"}


def test_validate_imports_no_torch():
    verb = "import sys; from kickbench.cli import main; code = main(['validate', 'mini_home_field', 'equivariant'])"
    code = f"{verb}; assert code == 0; assert not [m for m in sys.modules if m.startswith('torch.')]"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.count(": fine") == 3


def test_no_verb_is_a_usage_error(capsys):
    with pytest.raises(SystemExit) as stop:
        main([])
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert "VERB" in said
    assert len(re.findall("^  kickbench ", said, re.MULTILINE)) == 5


def test_help_lists_every_verb(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    verbs = "run eval validate show schema terms list table bench render play"
    for verb in verbs.split():
        assert re.search(rf"^ +{verb} +\S", text, re.MULTILINE), verb


# show


def comments(text: str) -> dict[str, str]:
    """Line of YAML -> its comment."""
    lines = (line.partition("  # ") for line in text.splitlines())
    return {yaml.strip(): comment.strip() for yaml, _, comment in lines if comment}


def test_show_says_where_each_value_comes_from(place, printed):
    sources = comments(printed("show", "tasks/mini_home_field.yaml", "--set", "ball.mass=0.2"))
    home, general = Path("tasks/mini_home_field.yaml"), Path("tasks/mini_general.yaml")
    row = {path: path.read_text().splitlines() for path in (home, general)}
    assert sources["mass: 0.2"] == "--set ball.mass=0.2"
    assert sources["angle: [0.0, 0.8]"] == f"{home}:{row[home].index('    angle: [0.0, 0.8]') + 1}"
    timestep = next(i for i, line in enumerate(row[general], 1) if line.startswith("  timestep: "))
    assert sources["timestep: 0.005"] == f"{general}:{timestep}"
    assert sources["condim: 6"] == "default"


def test_what_show_prints_is_the_same_task(place, printed):
    text = printed("show", "tasks/mini_home_field.yaml")
    Path("shown.yaml").write_text(text)
    values = [line.partition("  # ")[0].rstrip() for line in text.splitlines()]
    assert [
        line.partition("  # ")[0].rstrip() for line in printed("show", "shown.yaml").splitlines()
    ] == values


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("methods/mini/equivariant.yaml", "type: equivariant"),
        ("assets/mini_kicker/robot.yaml", "base: trunk"),
        ("methods/representations/standard.yaml", "actions: actions"),
    ],
)
def test_show_knows_every_kind_of_file(place, printed, file, line):
    assert comments(printed("show", file))[line].startswith(f"{file}:")


def test_show_of_a_wrong_file_fails_like_validate(place, capsys):
    assert main(["show", "tasks/mini_general.yaml", "--set", "ball.mass=-1"]) == 2
    assert capsys.readouterr().err == (
        "--set ball.mass=-1: ball.mass: expected a number greater than 0, found the number -1\n"
    )


# schema


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


def resolve(schema, root):
    while "$ref" in schema:
        schema = root["$defs"][schema["$ref"].removeprefix("#/$defs/")]
    return schema


def test_schema_is_a_json_schema_that_knows_the_keys_of_the_shipped_files(kind, printed):

    schema = json.loads(printed("schema", kind))
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert schema["additionalProperties"] is False
    for path in SHIPPED[kind]:
        assert set(load_document(path).data) <= set(schema["properties"]), path


def test_the_name_of_the_folder_stands_for_experiments_too(printed):
    assert printed("schema", "reported") == printed("schema", "experiment")


def test_every_property_of_a_schema_is_described(kind, printed):
    schema = json.loads(printed("schema", kind))
    for name, rule in schema["properties"].items():
        assert rule.get("description") or resolve(rule, schema).get("description"), name


def test_the_schema_of_a_task_lists_every_term(printed):
    schema = json.loads(printed("schema", "task"))

    def terms(*path: str) -> set[str]:
        rule = schema
        for key in path:
            rule = resolve(rule["properties"][key], schema)
        return set(rule["properties"])

    known = catalog()
    assert terms("rewards") == {*known["reward"], "scale_by_dt"}
    assert terms("terminations") == set(known["termination"])
    assert terms("randomization") == set(known["randomization"])
    assert terms("observations", "actor") == terms("observations", "critic") == set(known["observation"])


@pytest.mark.parametrize(
    "path", [p for paths in SHIPPED.values() for p in paths], ids=lambda p: f"{p.parent.name}-{p.name}"
)
def test_a_shipped_file_satisfies_its_schema(path, printed):
    jsonschema = pytest.importorskip("jsonschema")
    import yaml

    kind = next(kind for kind, paths in SHIPPED.items() if path in paths)
    jsonschema.validate(yaml.safe_load(path.read_text()), json.loads(printed("schema", kind)))


# terms


def test_terms_lists_every_term_with_its_unit_and_source(printed):
    lines = printed("terms").splitlines()
    for term in [term for table in catalog().values() for term in table.values()]:
        start = lines.index(term.name, lines.index(f"{term.kind}s"))
        end = lines.index("", start)
        text = " ".join(line.strip() for line in lines[start:end])
        assert f"unit {term.units}; source {term.source}" in text
        assert term.summary in text


def test_terms_lists_parameters_with_their_meaning_and_default(printed):
    text = " ".join(printed("terms").split())
    assert "- sigma: Distance sensitivity sigma, sqrt(m). (required)" in text
    assert re.search(r"- until_touch: Zero once the ball was touched .* \(default True\)", text)
    assert "every reward accepts - weight: Factor of the term" in text
    assert "needs foot_ball" in text


def test_terms_are_headed_by_their_kinds(printed):
    lines = printed("terms").splitlines()
    kinds = ["observations", "rewards", "terminations", "randomizations"]
    assert [line for line in lines if line in kinds] == kinds


# list


def test_list_names_files_of_every_kind_with_their_descriptions(printed):
    text = printed("list")
    headings = [line for line in text.splitlines() if not line.startswith(" ")]
    assert headings == ["task:", "method:", "robot:", "representations:", "experiment:"]
    assert re.search(r"^  mini_general +Mini kicker, ball and target anywhere in front$", text, re.MULTILINE)
    assert re.search(r"^  mini/baseline +Plain PPO$", text, re.MULTILINE)
    assert re.search(r"^  mini_kicker$", text, re.MULTILINE)


def test_a_table_of_no_runs_is_an_error(place, capsys):
    assert main(["table", "runs"]) == 2
    assert capsys.readouterr().err == "no finished run in runs\n"


@pytest.fixture
def runs(place):
    """Two finished runs, and one whose result is damaged."""
    measured = ROOT / "results/measured/mini_home_field/baseline"
    for name in ("a/seed0", "b/seed1"):
        shutil.copytree(measured / Path(name).name, place / name)
    Path("a/seed2").mkdir()
    Path("a/seed2/metrics.json").write_text("{")


@pytest.mark.parametrize("verb", ["table", "compare"])
def test_a_folder_without_a_run_is_an_error_beside_one_with_runs(runs, capsys, verb):
    assert main([verb, "a", "c", "b"]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == "no finished run in c"


def test_a_run_counts_once_however_often_it_is_named(runs, printed):
    assert printed("table", "a", "a/seed0", "./a") == printed("table", "a")


def test_the_columns_of_a_table_can_be_those_of_the_kick(runs, printed):
    assert printed("table", "a", "--columns", "success") == printed("table", "a")
    text = printed("table", "a", "--columns", "kick")
    assert text.startswith("task: mini_home_field: kick\n")
    assert ["baseline", "0"] in [line.split()[:2] for line in text.splitlines()]


@pytest.mark.parametrize(
    "argv",
    [["table", "a"], ["table", "a", "--columns", "kick"], ["compare", "a", "b"]],
    ids=" ".join,
)
def test_a_damaged_result_is_told_and_left_out(runs, capsys, argv):
    assert main(argv) == 0
    printed = capsys.readouterr()
    (line,) = [line for line in printed.out.splitlines() if "a/seed2" in line]
    assert line == "left out: a/seed2: damaged (SHA256SUMS: missing)"


def test_show_fields_prints_how_everything_that_is_seen_and_done_mirrors(printed):
    text = printed("show", "tasks/mini_home_field.yaml", "--fields", "methods/mini/equivariant.yaml")
    observed, criticised, actions = text.split("\n\n")
    assert re.search(r"^ball_position +6:9 +3  2 trivial \+ 1 sign$", observed, re.MULTILINE)
    assert re.search(r"^total +0:39 ", criticised, re.MULTILINE)
    assert "left_hip_yaw <-> -right_hip_yaw" in actions.splitlines()


def test_show_fields_of_a_missing_method_is_an_error_that_names_it(capsys):
    assert main(["show", "tasks/mini_home_field.yaml", "--fields", "methods/mini/equivariantt.yaml"]) == 2
    assert "equivariantt.yaml: no such file, and no method of this name" in capsys.readouterr().err


# names


def test_list_prints_names_that_every_verb_takes(printed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = printed("list").splitlines()
    start, end = lines.index("task:") + 1, lines.index("method:")
    tasks = [line.split()[0] for line in lines[start:end]]
    assert tasks == [path.relative_to(ROOT / "tasks").with_suffix("").as_posix() for path in SHIPPED_TASKS]
    assert "episode:" in printed("show", tasks[-1])
    assert "mini_home_field with equivariant: fine" in printed(
        "validate", "mini_home_field", "mini/equivariant"
    )


@pytest.mark.parametrize(
    ("task", "folder"),
    [("mini_general", "methods/mini"), ("k1_lite", "methods"), ("studies/no_arm_penalties", "methods")],
)
def test_a_methods_name_means_that_for_the_tasks_robot(task, folder):
    assert find_method("baseline", find(task, "task")) == ROOT / folder / "baseline.yaml"
    assert find_method("lite/baseline", find("k1_lite", "task")) == ROOT / "methods/lite/baseline.yaml"


def test_a_name_that_is_a_folder_here_is_still_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mini_general").mkdir()
    assert find("mini_general", "task") == ROOT / "tasks/mini_general.yaml"
    Path("mini_general.yaml").touch()
    assert find("mini_general.yaml", "task") == Path("mini_general.yaml")
    with pytest.raises(KickbenchError, match="did you mean 'mini_goal'"):
        find("mini_goal.yaml", "task")


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (
            ["run", "mini_home_feild", "equivariant"],
            "mini_home_feild: no such file, and no task of this name (did you mean 'mini_home_field'?)",
        ),
        (
            ["run", "mini_home_field", "equivarint"],
            "equivarint: no such file, and no method of this name (did you mean 'equivariant'?)",
        ),
        (
            ["run", "quadruped_home_field", "mirror_loss"],
            "mirror_loss: this method is not for the task's robot, quadruped\n",
        ),
        (
            ["run", "k1_general", "mini/equivariant"],
            "mini/equivariant: this method is not for the task's robot, booster_k1; "
            "use equivariant or cpu/equivariant or lite/equivariant",
        ),
        (
            ["run", "mini_general", str(ROOT / "methods/lite/ppo.yaml")],
            "ppo.yaml: this method is not for the task's robot, mini_kicker; use mini/ppo",
        ),
        (["run", "k1_general", "nowhere/x.yaml"], "nowhere/x.yaml: no such file, and no method"),
        (["run", "nowhere/x.yaml", "equivariant"], "nowhere/x.yaml: no such file, and no task"),
        (
            ["run", "mini/equivariant", "mini_home_field"],
            "mini/equivariant: found the name of a method, expected task (in TASK METHOD the task comes first)",
        ),
        (["reproduce", "k1_general"], "k1_general: found the name of a task, expected experiment\n"),
        (["validate", "k1_generl"], "did you mean 'k1_general'?"),
        (["reproduce", "general_fst"], "no experiment of this name (did you mean 'general_fast'?)"),
    ],
)
def test_a_wrong_name_is_refused_before_anything_heavy_is_imported(argv, said, tmp_path):
    code = f"import os, sys; os.chdir({str(tmp_path)!r}); import kickbench.cli; code = kickbench.cli.main({argv}); "
    code += "sys.exit(code + 10 * ('torch' in sys.modules or 'mujoco' in sys.modules))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 2, "12: torch or MuJoCo was imported"
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_terms_of_one_kind(printed):
    text = printed("terms", "rewards")
    assert text.startswith("rewards\n-------\n")
    assert text in printed("terms")
    assert not {"observations", "terminations"} & set(text.splitlines())


@pytest.mark.parametrize("folder", ["", "deep/er/"])
@pytest.mark.parametrize(("kind", "base"), [("task", "mini_general"), ("method", "mini/equivariant")])
def test_a_new_file_is_its_base_until_a_line_is_uncommented(
    tmp_path, monkeypatch, printed, kind, base, folder
):
    monkeypatch.chdir(tmp_path)
    assert printed("new", kind, f"{folder}mine", "--from", base) == f"{folder}mine.yaml\n"
    file = Path(f"{folder}mine.yaml")
    mine, theirs = load_document(file), load_document(find(base, kind))
    assert {**mine.data, "description": ""} == {**theirs.data, "description": ""}
    text = file.read_text()
    key = "max_steps" if kind == "task" else "gamma"
    (line,) = [line for line in text.splitlines() if f" {key}: " in line]
    above = "episode" if kind == "task" else "algorithm"
    text = text.replace(
        line, line[2:].split(":")[0] + ": 0.5" if kind == "method" else line[2:].split(":")[0] + ": 7"
    )
    file.write_text(text.replace(f"# {above}:", f"{above}:"))
    assert load_document(file).data[above] == {**theirs.data[above], key: 7 if kind == "task" else 0.5}
    assert main(["validate", str(file)]) == 0
    assert main(["new", kind, f"{folder}mine", "--from", base]) == 2


def test_a_shell_completes_names(tmp_path):
    words = {"COMP_WORDS": "kickbench run mini_", "COMP_CWORD": "2", "_KICKBENCH_COMPLETE": "complete_bash"}
    environment = {**os.environ, **words, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", "kickbench"], capture_output=True, text=True, check=False, env=environment
    )
    assert done.stdout.split() == [
        "mini_general",
        "mini_goal",
        "mini_home_field",
        "mini_moving_ball",
        "mini_obstacles",
    ]


@pytest.mark.parametrize("name", ["", ".", "/", ".."])
def test_what_is_no_name_of_a_file_defines_nothing(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "task", name, "--from", "mini_general"]) == 2
    assert capsys.readouterr().err == f"'{name}' is no name of a file\n"
    assert not list(tmp_path.iterdir())
