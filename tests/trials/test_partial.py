"""Partial symmetry: what a method excludes is free, and the rest stays equivariant."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from kickbench.audit.audit import audit
from kickbench.evaluation.probes import EquivarianceProbe
from kickbench.nets.actor_critic import build_actor, build_critic
from kickbench.nets.layers import EquivariantLinear
from kickbench.symmetry.representation import REGULAR, SIGN, TRIVIAL, Representation, regular
from kickbench.symmetry.torch_ops import Mirror
from kickbench.training.ppo import build_ppo
from kickbench.trials.trial import Trial

from ..support import complaints_of
from ..test_goldens import ROOT

FIELD, JOINT, PARTNER = "ball_position", "left_hip_yaw", "right_hip_yaw"


@pytest.fixture
def partial(experiment):
    """Loads a mini experiment whose method excludes names: `partial(method, *names)`."""

    def load(method: str = "equivariant", *names: str) -> Trial:
        excluded = ", ".join(names or (FIELD, JOINT))
        return experiment("mini_general", method, f"symmetry.exclude=[{excluded}]")

    return load


def networks(trial: Trial, seed: int = 0):
    """Actor and critic as after a training: every parameter and statistic is random."""
    torch.manual_seed(seed)
    actor = build_actor(trial.method.spec, trial.symmetry.groups["actor"], trial.symmetry.actions)
    critic = build_critic(trial.method.spec, trial.symmetry.groups["critic"])
    for group, network in (("actor", actor), ("critic", critic)):
        for name, parameter in network.named_parameters():
            if "std" not in name:
                torch.nn.init.normal_(parameter, std=0.3)
        seen = 3.0 * torch.randn(500, trial.symmetry.groups[group].dim) + torch.randn(1)
        network.update_normalization(TensorDict({group: seen}, batch_size=[500]))
    return actor.eval(), critic.eval()


def observed(trial: Trial, group: str) -> tuple[torch.Tensor, Mirror]:
    table = trial.symmetry.groups[group]
    return torch.randn(64, table.dim, generator=torch.Generator().manual_seed(1)), Mirror(
        table.representation
    )


def answers(network, group: str, observation: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        return network(TensorDict({group: observation}, batch_size=[len(observation)]))


@pytest.mark.parametrize("names", [(FIELD,), (JOINT,), (FIELD, JOINT, "previous_action")])
def test_while_what_is_excluded_is_zero_the_policy_is_equivariant_and_the_value_invariant(partial, names):
    trial = partial("equivariant", *names)
    actor, critic = networks(trial)
    seen, mirror = observed(trial, "actor")
    act, seen = Mirror(trial.symmetry.actions), mirror.held(seen)
    here, there = answers(actor, "actor", seen), answers(actor, "actor", mirror(seen))
    torch.testing.assert_close(
        act.held(there), act.held(act(here)), rtol=0.0, atol=1e-6 * float(here.abs().max())
    )
    assert (there - act(here)).abs().max() > 0.01 * here.abs().max() or JOINT not in names
    seen, mirror = observed(trial, "critic")
    here, there = (answers(critic, "critic", part) for part in (mirror.held(seen), mirror(mirror.held(seen))))
    torch.testing.assert_close(there, here, rtol=0.0, atol=2e-6 * float(here.abs().max()))


def test_what_is_excluded_may_break_the_symmetry_even_of_a_symmetric_observation(partial):
    trial = partial()
    actor, _ = networks(trial)
    seen, mirror = observed(trial, "actor")
    symmetric = 0.5 * (mirror.held(seen) + mirror(mirror.held(seen))) + (seen - mirror.held(seen))
    answer, act = answers(actor, "actor", symmetric), Mirror(trial.symmetry.actions)
    torch.testing.assert_close(mirror(symmetric), symmetric)
    # The trivial representation would force the difference to zero, as without an exclusion.
    assert act.held(answer - act(answer)).abs().max() > 0.1


def test_a_layer_reaches_every_matrix_in_the_columns_and_rows_that_are_excluded():
    layer = EquivariantLinear((SIGN + REGULAR).excluding([1]), regular(2))
    out = EquivariantLinear(regular(2), (SIGN + REGULAR + TRIVIAL).excluding([0, 2]))
    for chosen, columns in ((layer, [1, 2]), (out, [0, 1, 2])):
        jacobian = torch.autograd.functional.jacobian(chosen.base, chosen.free.detach())
        rows = jacobian[columns] if chosen is layer else jacobian[:, columns]
        assert np.linalg.matrix_rank(rows.flatten(0, 1).numpy()) == rows[..., 0].numel()
    weights = torch.cat(
        [EquivariantLinear(layer.in_representation, regular(64)).dense()[0] for _ in range(40)]
    )
    torch.testing.assert_close(weights.var(dim=0), torch.full((3,), 1 / 9), rtol=0.15, atol=0.0)


def test_a_pair_is_excluded_by_either_name_from_every_field_of_joints_and_from_the_actions(partial):
    by_left, by_right = partial("equivariant", JOINT).symmetry, partial("equivariant", PARTNER).symmetry
    assert by_left.groups == by_right.groups
    assert by_left.actions == by_right.actions
    assert set(by_left.excluded) == set(by_right.excluded) == {JOINT, PARTNER}
    actor = by_left.groups["actor"]
    assert {name: len(r.excluded) for name, r in actor.fields if r.excluded} == {
        "joint_pos": 2,
        "joint_vel": 2,
        "previous_action": 2,
    }
    assert by_left.actions.excluded == {3, 5}
    assert "2 excluded" in str(by_left.actions)


def test_statistics_and_noise_of_what_is_excluded_are_its_own(partial):
    trial = partial()
    actor, _ = networks(trial)
    normaliser, excluded = (
        actor.obs_normalizer,
        sorted(trial.symmetry.groups["actor"].representation.excluded),
    )
    assert (normaliser._mean[:, excluded] == 0.0).all(), "zero stays zero"
    left, right = trial.symmetry.groups["actor"].slice("joint_pos").start + np.array([0, 2])
    assert normaliser._var[0, left] != normaliser._var[0, right]
    assert len(actor.distribution.orbits) == len(trial.symmetry.actions.orbits()) == 6


def test_a_mirrored_sample_keeps_what_is_excluded_and_the_mirror_loss_leaves_its_actions_out(partial):
    trial = partial("mirror_loss")
    groups = {name: torch.randn(8, table.dim) for name, table in trial.symmetry.groups.items()}
    seen = TensorDict(groups, batch_size=[8])
    symmetry = build_ppo(trial, seen, torch.device("cpu")).symmetry
    doubled, actions = symmetry.data_augmentation_func(None, seen, torch.randn(8, trial.symmetry.actions.dim))
    place = trial.symmetry.groups["actor"].slice(FIELD)
    torch.testing.assert_close(doubled["actor"][8:, place], seen["actor"][:, place])
    assert (doubled["actor"][8:] != seen["actor"]).any()
    torch.testing.assert_close(actions[8:, [3, 5]], actions[:8, [3, 5]])

    def only_excluded(batch: TensorDict) -> torch.Tensor:
        return torch.nn.functional.pad(batch["actor"][:, 1:2], (3, 3))

    class Batch:
        observations = seen

    assert (only_excluded(doubled)[8:] != only_excluded(doubled)[:8]).any()
    assert symmetry.compute_loss(only_excluded, Batch(), 8) == 0.0


def test_the_equivariance_error_is_that_of_the_rest_and_names_what_it_leaves_out(partial):
    trial = partial()
    actor, _ = networks(trial)
    symmetry = trial.symmetry
    tables = {name: table.representation for name, table in symmetry.groups.items()}
    probe = EquivarianceProbe(actor, tables, symmetry.actions, symmetry.excluded)
    groups = {name: torch.randn(32, table.dim) for name, table in symmetry.groups.items()}
    seen, steps = TensorDict(groups, batch_size=[32]), torch.zeros(32)
    with torch.inference_mode():
        probe(seen, actor(seen), steps, steps == 0)
    found = probe.result()
    assert found.relative < 1e-6
    assert found.but_for == (FIELD, JOINT, PARTNER)


def test_wrong_exclusions_are_reported_at_their_place(experiment):
    def of(method: str, names: str) -> list[str]:
        return complaints_of(experiment, "mini_general", method, f"symmetry.exclude={names}")

    (line,) = of("equivariant", "[ball_positon]")
    assert (
        "symmetry.exclude.0: the task has no observation field 'ball_positon', and the robot no such joint"
        in line
    )
    assert "(did you mean 'ball_position'?)" in line
    (line,) = of("baseline", "[ball_position]")
    assert "the method uses no symmetry" in line
    (line,) = of("equivariant", "[ball_position, ball_position]")
    assert "ball_position is there twice" in line
    (line,) = of("equivariant", "[]")
    assert "symmetry.exclude: expected" in line


def test_no_symmetry_may_be_left_over_of_the_actions(partial, experiment):
    everything = Representation((0, 2, 1), (1, 1, 1)).excluding([0, 1])
    assert everything.excluded == {0, 1, 2}, "a pair goes together"


def test_the_audit_states_what_remains_equivariant_and_proves_the_tables_in_full(tmp_path):
    method = tmp_path / "partial.yaml"
    method.write_text(f"extends: {ROOT}/methods/mini/equivariant.yaml\nsymmetry: {{exclude: [{FIELD}]}}\n")
    report = audit(ROOT / "tasks/mini_general.yaml", method, states=128, threads=1)
    assert report.exit_code == 0
    assert any(row.name.startswith(FIELD) and row.verdict == "ok" for row in report.rows)
    (line,) = [line for line in report.lines() if "but for" in line]
    assert line.startswith(f"the method's symmetry: equivariant but for: {FIELD}")
