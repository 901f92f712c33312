"""Dividing time among sections."""

from __future__ import annotations

from contextlib import ExitStack

import pytest
import torch

from kickbench.bench import profile
from kickbench.bench.profile import Sections, profile_iteration, step_sections, swapped, update_sections
from kickbench.bench.training import Iterations


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test moves."""
    now = [0.0]
    monkeypatch.setattr(profile.time, "perf_counter", lambda: now[0])

    def wait(seconds: float) -> None:
        now[0] += seconds

    return wait


def seconds_of(sections: Sections) -> dict[str, float]:
    return {section.name: section.seconds for section in sections.result()}


def test_a_section_is_not_charged_for_the_sections_within_it(clock):
    sections = Sections(torch.device("cpu"))
    with sections.section("outer"):
        clock(1.0)
        with sections.section("inner"):
            clock(5.0)
        clock(2.0)
    clock(100.0)
    with sections.section("outer"):
        clock(4.0)
    assert seconds_of(sections) == {"outer": 7.0, "inner": 5.0}
    assert [section.share for section in sections.result()] == pytest.approx([7 / 12, 5 / 12])


def test_only_the_making_of_items_is_charged_to_a_generator(clock):
    sections = Sections(torch.device("cpu"))

    def items():
        for item in range(3):
            clock(1.0)
            yield item

    with sections.section("loop"):
        got = []
        for item in sections.iterated("items", items)():
            clock(10.0)
            got.append(item)
    assert got == [0, 1, 2]
    assert seconds_of(sections) == {"loop": 30.0, "items": 3.0}


def test_what_was_swapped_comes_back_even_after_an_error():
    class Thing:
        def method(self) -> str:
            return "own"

    thing = Thing()

    def fail() -> None:
        with swapped(thing, "method", lambda: "other"):
            assert thing.method() == "other"
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fail()
    assert thing.method() == "own"
    assert vars(thing) == {}


def test_profiling_changes_no_result_and_leaves_nothing_behind(experiment):
    small = ("algorithm.num_envs=4", "algorithm.steps_per_env=4")
    training = Iterations(experiment("mini_general", "augmentation", *small), "cpu", 1)
    trainer = training.trainer
    touched = (
        trainer.env,
        trainer.env.engine,
        trainer.ppo,
        trainer.ppo.actor,
        trainer.ppo.storage,
        torch.autograd,
    )
    methods = ("step", "state", "update", "act", "forward", "mini_batch_generator")
    before = [{name: vars(thing).get(name) for name in (*methods, "backward")} for thing in touched]
    task = trainer.env.task
    profile_iteration(training, 1)
    after = [{name: vars(thing).get(name) for name in (*methods, "backward")} for thing in touched]
    assert after == before
    assert trainer.env.task is task


def test_sections_leave_the_training_as_it_is(experiment):
    small = ("algorithm.num_envs=4", "algorithm.steps_per_env=4")
    chosen = experiment("mini_general", "augmentation", *small)
    weights = []
    for sectioned in (False, True):
        training = Iterations(chosen, "cpu", 1)
        env, ppo = training.trainer.env, training.trainer.ppo
        sections = Sections(env.device)
        with ExitStack() as stack:
            if sectioned:
                stack.enter_context(step_sections(env, ppo, sections))
                stack.enter_context(update_sections(ppo, sections))
            training()
            training()
        weights.append(torch.cat([parameter.flatten() for parameter in ppo.actor.parameters()]))
    assert torch.equal(*weights)
