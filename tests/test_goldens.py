"""What kickbench prints and simulates, as frozen in `goldens/`.

`KICKBENCH_WRITE_GOLDENS=1 pytest tests/test_goldens.py` writes them again: in a commit of its own that says why.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path

import pytest
import torch

from kickbench import make

from .support import printed

ROOT = Path(__file__).parent.parent
GOLDENS = Path(__file__).parent / "goldens"
MEASURED = ROOT / "results/measured"
EXPERIMENTS = sorted(path.name for path in MEASURED.iterdir() if path.is_dir())
JUDGED = [name for name in EXPERIMENTS if (ROOT / f"results/reported/{name}.yaml").is_file()]
SPECS = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in ("tasks", "methods", "assets", "results/reported")
    for path in (ROOT / folder).rglob("*.yaml")
)
ENVS, STEPS = 8, 40


@pytest.fixture(autouse=True)
def in_the_repository(monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("COLUMNS", "120")


def frozen(name: str, content: str) -> str:
    """The golden of that name, which is `content` if goldens are being written."""
    path = GOLDENS / name
    if os.environ.get("KICKBENCH_WRITE_GOLDENS"):
        path.parent.mkdir(exist_ok=True)
        path.write_text(content)
    return path.read_text()


@pytest.mark.parametrize("experiment", JUDGED)
def test_claims_are_judged_as_before(experiment, capsys):
    text = printed(capsys, "claims", f"results/reported/{experiment}.yaml", "--json")
    assert json.loads(text) == json.loads(frozen(f"claims_{experiment}.json", text))


@pytest.mark.parametrize("columns", ["success", "kick"])
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_tables_print_the_same_figures(experiment, columns, capsys):
    text = printed(capsys, "table", f"results/measured/{experiment}", "--columns", columns)
    assert text == frozen(f"table_{experiment}_{columns}.txt", text)


def test_resolved_specs_are_the_same(capsys):
    """Values and where they came from, of every shipped file."""
    texts = {spec: printed(capsys, "show", spec).replace(str(ROOT), "") for spec in SPECS}
    # Comments stand behind the longest line, which may be a path: their column depends on where the repository is.
    shown = {
        spec: hashlib.sha256(re.sub(" +#", " #", text).encode()).hexdigest() for spec, text in texts.items()
    }
    text = json.dumps(shown, indent=1)
    assert shown == json.loads(frozen("show.json", text))


@pytest.mark.parametrize("task", ["mini_home_field", "mini_general", "k1_lite", "k1_general_fast"])
def test_trajectories_are_the_same(task):
    """Means of what the first steps observe and pay: equal to rounding, so that processors may differ."""
    text = json.dumps(trajectory(task))
    assert json.loads(text) == {
        key: pytest.approx(values, rel=1e-3, abs=1e-4)
        for key, values in json.loads(frozen(f"trajectory_{task}.json", text)).items()
    }


def trajectory(task: str) -> dict[str, list[float]]:
    env = make(ROOT / f"tasks/{task}.yaml", ENVS, seed=3, threads=1)
    draws = torch.Generator().manual_seed(5)
    figures: dict[str, list[float]] = {"actor": [], "critic": [], "reward": [], "done": []}
    bits = hashlib.sha256()
    for _ in range(STEPS):
        observations, rewards, dones, _ = env.step(0.5 * torch.randn(ENVS, env.num_actions, generator=draws))
        named = {
            "actor": observations["actor"],
            "critic": observations["critic"],
            "reward": rewards,
            "done": dones,
        }
        for key, value in named.items():
            bits.update(value.contiguous().numpy().tobytes())
            figures[key].append(float(value.double().abs().mean()))
    print(f"{task}: {bits.hexdigest()}")  # bit for bit, where the processor is the same
    return figures
