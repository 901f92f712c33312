"""Verb `demo`: three methods trained on the mini home-field task, and what came of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from kickbench.cli.reproduce import carry_out, exit_code
from kickbench.config.shipped import find
from kickbench.errors import KickbenchError, shown
from kickbench.launch.plan import Plan, Selection, make_plan
from kickbench.results.frame import load_runs
from kickbench.results.tables import render_table
from kickbench.sim.cpu import usable_cores
from kickbench.trials.experiment import load_experiment

EXPERIMENT = "mini_home_field"
CONDITIONS = ("baseline", "augmentation", "equivariant")
_FILM = ("baseline", "equivariant")
_FILM_SIZE, _EPISODES = (320, 240), 2
_NOTHING = 0.01
"""Success that may be lost and still count as nothing lost."""
_LEARNED = 0.05
"""Success below which nothing is said of the other side."""


def demo(out: Path, scale: float | None) -> int:
    """Trains, shows and says what to do next; the exit code."""
    selection = Selection(only=CONDITIONS, seeds=(0,), scale=scale, out=out)
    plan = make_plan(load_experiment(find(Path(EXPERIMENT), "reported")), selection)
    cores = usable_cores()
    at_a_time = min(len(plan.runs), cores)
    print(
        "The mini kicker trains with ball and target on its left only. Which method kicks as well on its right?"
    )
    print(
        f"Three methods, one seed each, {at_a_time} at a time; Ctrl-C stops, the same command goes on.\n",
        flush=True,
    )
    jobs = carry_out(plan, at_a_time, max(1, cores // at_a_time))
    if code := exit_code(jobs):
        return code
    runs = load_runs(plan.folder)
    print(f"\n{render_table(runs)}\n\n{sentence(runs)}\n", flush=True)
    for line in _pictures(plan):
        print(line, flush=True)
    run = shown(plan.folder / "equivariant/seed0")
    print(f"""
Next:
  kickbench play {run}     # watch the policy in a browser
  kickbench new task my_task --from mini_general     # a task of your own
  kickbench reproduce {EXPERIMENT} --jobs {at_a_time}          # five seeds, and a verdict on every claim""")
    return 0


def sentence(runs: pd.DataFrame) -> str:
    """What the policies of one seed lose on the side that they have never seen, in words.

    Args:
        runs: Evaluated runs, one a method, as `load_runs` reads them.
    """
    rates = {(run.method, run.side): float(run.success_rate) for _, run in runs.iterrows()}
    parts = [
        _part(method, rates[method, "in_distribution"], rates[method, "mirrored"]) for method in CONDITIONS
    ]
    text = f"{'; '.join(parts)}."
    return f"{text[0].upper()}{text[1:]}\n(One seed: another one gives other figures of the same kind.)"


def _part(method: str, home: float, away: float) -> str:
    name = method if method == "augmentation" else f"the {method} policy"
    rates = f"{100 * home:.0f} -> {100 * away:.0f} %"
    if home < _LEARNED:
        return f"{name} has not learned the task: {rates}"
    if away < home / 2.0:
        return f"{name} fails on the side that it never saw: {rates}"
    if home - away <= _NOTHING:
        return f"{name} loses nothing there: {rates}"
    return f"{name} loses {100 * (home - away):.0f} points there: {rates}"


def _pictures(plan: Plan) -> Iterator[str]:
    """Writes the page and a film of the mirrored side, where this machine can; what has been written."""
    from kickbench.report.write import write_report
    from kickbench.training.trained import load_run
    from kickbench.view.film import film_runs

    folder = plan.folder
    try:
        write_report(folder, folder / "report.html")
        yield f"report: {shown(folder / 'report.html')}"
        paths = [folder / name / "seed0" for name in _FILM]
        film, task = folder / "film.webp", load_run(paths[0]).trial.task
        film_runs(task, paths, film, _EPISODES, task.spec.evaluation.seed, _FILM_SIZE, mirrored=True)
        yield f"film:   {shown(film)} (the side that the baseline never saw)"
    except KickbenchError as error:
        yield f"not drawn: {error}"
