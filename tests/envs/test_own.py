"""Terms of one's own: read without being imported, part of a run's identity, imported by envs alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from kickbench.cli import main
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.own import read_terms
from kickbench.errors import KickbenchError, SpecError
from kickbench.results.identity import canonical_source, identity_of
from kickbench.training.trained import load_run
from kickbench.trials.trial import load_trial

ROOT = Path(__file__).parents[2]
METHOD = ROOT / "methods/mini/baseline.yaml"
SMALL = [
    "algorithm.num_envs=8",
    "algorithm.iterations=1",
    "evaluation.episodes=4",
    "network.actor_hidden=[8]",
]
CODE = '''
from pathlib import Path
from kickbench.envs.own import observation, reward, termination

Path(__file__).with_name("imported").touch()

@reward(units="m")
def ball_height(state, limit: float = 0.5):
    """Height of the ball, at most `limit`, m."""
    return state.ball_pos[:, 2].clamp(max=limit)  # above the floor

@termination()
def ball_far(state, distance: float):
    return (state.ball_pos - state.base_pos).norm(dim=1) > distance
'''
TASK = f"""
extends: {ROOT}/tasks/mini_general.yaml
terms: my_terms.py
rewards:
  ball_height: {{weight: 2.0}}
terminations:
  ball_far: {{distance: 3.0}}
"""


@pytest.fixture
def task(tmp_path) -> Path:
    (tmp_path / "my_terms.py").write_text(CODE)
    (tmp_path / "high.yaml").write_text(TASK)
    return tmp_path / "high.yaml"


def run(task: Path, out: Path, *more: str) -> int:
    settings = [word for setting in SMALL for word in ("--set", setting)]
    return main(["run", str(task), str(METHOD), *settings, "--out", str(out), *more])


def test_terms_are_read_without_importing_the_file(task):
    height, far = read_terms(task.with_name("my_terms.py"))
    assert (height.name, height.kind, height.units) == ("ball_height", "reward", "m")
    assert height.summary == "Height of the ball, at most `limit`, m."
    assert height.params(weight=1.0).limit == 0.5
    assert far.kind == "termination"
    assert main(["validate", str(task)]) == main(["show", str(task)]) == 0
    assert not task.with_name("imported").exists()


def test_an_env_computes_them(task):
    compiled = load_trial(task, METHOD).task
    env = KickEnv(compiled, make_engine(compiled, 3), seed=0)
    assert not task.with_name("imported").exists()
    bound = next(
        bound for bound in compiled.rewards if bound.name == "ball_height" and bound.params.weight == 2.0
    )
    assert bound(env.state()) == pytest.approx([compiled.spec.ball.radius] * 3, abs=1e-3)
    assert task.with_name("imported").exists()


def test_only_envs_import_the_code_and_of_a_run_s_folder_only_if_it_is_trusted(task, tmp_path, capsys):
    out = tmp_path / "run"
    assert run(task, out) == 0
    stored = out / "specs/terms.py"
    assert stored.read_text() == CODE
    for command in (["table"], ["status"], ["eval", "--episodes", "2"]):
        main([command[0], str(out), *command[1:]])
        assert not stored.with_name("imported").exists()
    assert "--trust-code" in capsys.readouterr().err
    assert not load_run(out).trial.task.is_trusted
    assert main(["eval", str(out), "--episodes", "2", "--trust-code"]) == 0
    assert stored.with_name("imported").exists()


def test_the_code_is_part_of_the_identity_and_comments_are_not(task, tmp_path, capsys):
    file = task.with_name("my_terms.py")
    before = identity_of(load_trial(task, METHOD))
    file.write_text(CODE.replace("  # above the floor", "").replace("\n", "\r\n"))
    assert identity_of(load_trial(task, METHOD)) == before
    assert run(task, tmp_path / "run") == 0
    file.write_text(CODE.replace("max=limit", "max=2.0 * limit"))
    assert identity_of(load_trial(task, METHOD)).parts["terms"] != before.parts["terms"]
    assert run(task, tmp_path / "run", "--resume") == 2
    assert "the source of the terms: not that of the run" in capsys.readouterr().err


WRONG = {
    "def f(:": r"my_terms.py: not Python: invalid syntax \(my_terms.py, line 1\)",
    "x = 1": "no term: expected functions marked by @reward",
    "@reward\ndef f(state): ...": "write @reward\\(\\), with parentheses",
    "@reward(unit='m')\ndef f(state): ...": r"reward\(\) got an unexpected keyword argument 'unit'",
    "@reward()\ndef f(state, x): ...": "x: expected a type out of float, int",
    "@reward()\ndef f(state, x: float = y): ...": "x: expected a literal, found y",
    "@reward()\ndef f(state, weight: float): ...": "weight: every reward has this parameter",
    "@reward()\ndef f(*states): ...": r"expected \(state, parameters...\)",
    "@observation()\ndef f(state): ...": r"observation\(\) missing 1 required positional argument: 'size'",
    "@reward(needs=('foot_bal',))\ndef f(state): ...": "needs.0: Input should be .*'foot_ball'.* found 'foot_bal'",
    "@observation(0)\ndef f(state): ...": "representation.*: Input should be greater than 0",
    "@observation('trivail')\ndef f(state): ...": "unknown representation 'trivail'.*did you mean 'trivial'",
    "@reward()\ndef f(state): ...\n@reward()\ndef f(state): ...": "two terms of this name",
    "@reward()\ndef upright(state): ...": "upright: kickbench has a reward of this name",
}


@pytest.mark.parametrize("code", WRONG, ids=range(len(WRONG)))
def test_what_is_no_term_is_an_error_at_its_line(task, code):
    task.with_name("my_terms.py").write_text(code)
    with pytest.raises(SpecError, match=WRONG[code]):
        load_trial(task, METHOD)


FORWARD = """
from kickbench.envs.own import observation

@observation({size}, units="m/s")
def base_forward_and_lateral(state):
    return state.base_lin_vel[:, :2]
"""


@pytest.fixture
def observing(task):
    """Loads the task with an observation of one's own that states something, and a table with some fields."""

    def load(size: str, fields: str = "{}"):
        task.with_name("my_terms.py").write_text(FORWARD.format(size=size))
        task.with_name("table.yaml").write_text(f"fields: {fields}\n")
        task.write_text(
            f"extends: {ROOT}/tasks/mini_general.yaml\nterms: my_terms.py\n"
            "observations: {actor: {base_forward_and_lateral: {}}, critic: {base_forward_and_lateral: {}}}\n"
        )
        return load_trial(task, METHOD, [f"representations={task.with_name('table.yaml')}"])

    return load


def test_an_observation_states_how_it_mirrors(observing):
    stated = observing('"trivial + sign"').symmetry
    assert str(stated.groups["actor"]["base_forward_and_lateral"]) == "1 trivial + 1 sign"


def test_an_observation_that_states_its_length_alone_needs_an_entry_in_the_table(observing):
    with pytest.raises(SpecError, match="field 'base_forward_and_lateral' has no representation"):
        observing("2")
    by_table = observing("2", "{base_forward_and_lateral: trivial + sign}")
    assert by_table.symmetry == observing('"trivial + sign"').symmetry
    with pytest.raises(SpecError, match=r"fields.base_forward_and_lateral: 'sign' has dimension 1, .* has 2"):
        observing("2", "{base_forward_and_lateral: sign}")


def test_an_observation_of_another_width_than_it_states_is_an_error(observing):
    task = observing('"trivial + sign + trivial"').task
    complaint = "base_forward_and_lateral: .* it returns 2, and 'trivial . sign . trivial' has 3"
    with pytest.raises(KickbenchError, match=complaint):
        KickEnv(task, make_engine(task, 2), seed=0)


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        ("return 1.0", "ball_height returns float; a reward is torch.float32"),
        ("return state.ball_pos", r"ball_height returns torch.float32 \[3, 3\]"),
        ("return state.ball_pos.sum()", r"ball_height returns torch.float32 \[\]"),
        ("return state.no_such_thing", r"my_terms.py:10: in ball_height: AttributeError"),
    ],
)
def test_a_term_that_fails_names_itself(task, body, complaint):
    code = CODE.replace("return state.ball_pos[:, 2].clamp(max=limit)", body)
    task.with_name("my_terms.py").write_text(code)
    compiled = load_trial(task, METHOD).task
    env = KickEnv(compiled, make_engine(compiled, 3), seed=0)
    bound = next(bound for bound in compiled.rewards if bound.name == "ball_height")
    with pytest.raises(KickbenchError, match=complaint):
        bound(env.state())


def test_the_canonical_source_has_no_comments(task):
    assert "above the floor" not in canonical_source(task.with_name("my_terms.py"))


def test_the_example_of_the_readme_works(tmp_path):
    text = (ROOT / "tasks/README.md").read_text()
    section = text[text.index("## Terms of your own") :]
    code, task = (section.split(f"```{kind}\n")[1].split("```")[0] for kind in ("python", "yaml"))
    (tmp_path / "my_terms.py").write_text(code)
    file = tmp_path / "high.yaml"
    file.write_text(task.replace("mini_general.yaml", f"{ROOT}/tasks/mini_general.yaml"))
    compiled = load_trial(file, METHOD).task
    env = KickEnv(compiled, make_engine(compiled, 3), seed=0)
    bound = next(bound for bound in compiled.rewards if bound.name == "ball_height")
    assert bound(env.state()) == pytest.approx([compiled.spec.ball.radius] * 3, abs=1e-3)
