"""Every wrong entry of the K1's tables is caught; a check of the tables against themselves catches none.

Each mutant is one slip of the pen: a joint pair or a field with a flipped sign, with its partner swapped for another's,
or left out (as if nothing moved or changed sign).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import pytest
import torch
from tensordict import TensorDict

from kickbench.audit.record import Reflection
from kickbench.config.load import Loaded, load
from kickbench.config.method import RepresentationSpec
from kickbench.config.robot import JointPairs, JointSymmetrySpec
from kickbench.config.shipped import find
from kickbench.envs.engines import make_engine
from kickbench.envs.env import KickEnv
from kickbench.envs.term import Field
from kickbench.nets.actor_critic import build_actor
from kickbench.symmetry.field_table import FieldTable
from kickbench.symmetry.mirror import Image
from kickbench.symmetry.representation import BY_NAME, Representation, kind_of_coordinate
from kickbench.symmetry.torch_ops import Mirror
from kickbench.trials.trial import Symmetry, symmetry_of


@dataclass(frozen=True)
class Mutant:
    """A wrong table: what was done to which entry."""

    name: str
    entry: tuple[str, ...]
    symmetry: Symmetry
    image: Image


def joint_spec(image: Image) -> JointSymmetrySpec:
    lists = {name: ([], []) for name in BY_NAME}
    for joint, (partner, sign) in image.items():
        left, right = lists[kind_of_coordinate(partner == joint, sign)]
        if joint not in right:
            left.append(joint)
            right.append(partner)
    pairs = {name: JointPairs(left=tuple(lists[name][0]), right=tuple(lists[name][1])) for name in lists}
    central = {name: tuple(lists[name][0]) for name in ("trivial", "sign")}
    return JointSymmetrySpec(**central, regular=pairs["regular"], regular_sign=pairs["regular_sign"])


def joint_mutants(chosen) -> Iterator[Mutant]:
    table = chosen.task.robot.spec.symmetry.image()
    orbits = list(dict.fromkeys(tuple(sorted((joint, partner))) for joint, (partner, _) in table.items()))
    pairs = [orbit for orbit in orbits if orbit[0] != orbit[1]]

    def made(name: str, orbit: tuple[str, ...], changes: Image) -> Mutant:
        image = {**table, **changes}
        robot = chosen.task.robot
        spec = robot.spec.model_copy(update={"symmetry": joint_spec(image)})
        task = replace(chosen.task, robot=Loaded(spec, robot.document))
        return Mutant(name, orbit, symmetry_of(task, chosen.method.representations), image)

    for orbit in orbits:
        flipped = {joint: (table[joint][0], -table[joint][1]) for joint in orbit}
        yield made(f"flip joints {' and '.join(dict.fromkeys(orbit))}", orbit, flipped)
    for orbit, (c, d) in zip(pairs, pairs[1:] + pairs[:1], strict=True):
        a, b = orbit
        sign = table[a][1]
        changes = {a: (d, sign), d: (a, sign), b: (c, sign), c: (b, sign)}
        yield made(f"swap partners of {a} and {c}", (a, b, c, d), changes)
        yield made(f"drop the pair {a}, {b}", orbit, {a: (a, sign), b: (b, sign)})


def field_mutants(chosen) -> Iterator[Mutant]:
    symmetry, image = chosen.symmetry, chosen.task.robot.spec.symmetry.image()
    for name, right in symmetry.groups["critic"].fields:
        for what, wrong in wrong_representations(right).items():
            groups = {
                group: FieldTable(tuple((n, wrong if n == name else r) for n, r in table.fields))
                for group, table in symmetry.groups.items()
            }
            yield Mutant(f"{what} {name}", (name,), replace(symmetry, groups=groups), image)


def wrong_representations(right: Representation) -> dict[str, Representation]:
    size, permutation, signs = right.dim, right.permutation, right.signs
    identity = tuple(range(size))
    found = {"flip": Representation(permutation, tuple(-sign for sign in signs))}
    for orbit in right.orbits() if size <= 6 else ():
        flipped = tuple(-sign if i in orbit else sign for i, sign in enumerate(signs))
        found[f"flip component {orbit[0]} of"] = Representation(permutation, flipped)
    found["drop the signs of"] = Representation(permutation, (1,) * size)
    found["drop the swap of"] = Representation(identity, signs)
    found["drop"] = Representation(identity, (1,) * size)
    if permutation != identity:
        # The second component of each pair is taken for the next pair's.
        orbits = [orbit for orbit in right.orbits() if len(orbit) == 2]
        if len(orbits) > 1:
            (a, b), (c, d), *_ = orbits
            swapped = {a: d, d: a, b: c, c: b}
            places = tuple(swapped.get(i, j) for i, j in enumerate(permutation))
            equal = tuple(signs[a] if i in swapped else sign for i, sign in enumerate(signs))
            found["swap partners in"] = Representation(places, equal)
    # The same slip may have two names.
    names = {wrong: what for what, wrong in reversed(found.items()) if wrong != right}
    return {what: wrong for wrong, what in names.items()}


def action_mutants(chosen) -> Iterator[Mutant]:
    symmetry, image = chosen.symmetry, chosen.task.robot.spec.symmetry.image()
    for what, wrong in wrong_representations(symmetry.actions).items():
        yield Mutant(f"{what} actions", ("action",), replace(symmetry, actions=wrong), image)


def self_consistent(mutant: Mutant, method) -> bool:
    """What a check of the table against itself sees: rho^2 = 1, and a network built from it is equivariant under it."""
    fields, actions = mutant.symmetry.groups["actor"], mutant.symmetry.actions
    tables = [table.representation for table in mutant.symmetry.groups.values()] + [actions]
    involutions = all(((m := table.matrix()) @ m == torch.eye(table.dim).numpy()).all() for table in tables)
    policy = build_actor(method, fields, actions).eval()
    observed = torch.randn(32, fields.dim, generator=torch.Generator().manual_seed(0))
    images = Mirror(fields.representation)(observed)
    with torch.inference_mode():
        here, there = (policy(TensorDict({"actor": x}, batch_size=[32])) for x in (observed, images))
    error = (Mirror(actions)(here) - there).abs().max()
    return bool(involutions and error < 1e-4)


@pytest.fixture(scope="module")
def mutants(k1) -> list[Mutant]:
    chosen = k1.trial
    made = [*joint_mutants(chosen), *field_mutants(chosen), *action_mutants(chosen)]
    assert len({mutant.name for mutant in made}) == len(made)
    return made


def failures_of(audited, mutants) -> dict[str, list[str]]:
    """Mutant -> names of the rows that say that a table is wrong."""
    return {
        mutant.name: [
            row.name
            for row in audited.rows(mutant.symmetry, mutant.image)
            if row.failed and row.question == "table"
        ]
        for mutant in mutants
    }


@pytest.fixture(scope="module")
def failures(k1, mutants) -> dict[str, list[str]]:
    return failures_of(k1, mutants)


def test_the_audit_catches_every_wrong_entry_and_names_it(mutants, failures):
    assert len(mutants) >= 40
    named = [
        m.name for m in mutants if any(part in name for name in failures[m.name][:1] for part in m.entry)
    ]
    print(f"\n{len(mutants)} mutants: the audit catches {len(named)}")
    assert [mutant.name for mutant in mutants if mutant.name not in named] == []


@pytest.mark.slow
def test_on_an_unequal_robot_the_audit_catches_every_wrong_entry_as_well(unequal_k1, mutants):
    found = failures_of(unequal_k1, mutants)
    named = [m.name for m in mutants if any(part in name for name in found[m.name][:1] for part in m.entry)]
    print(f"\n{len(mutants)} mutants on a robot with unequal sides: the audit catches {len(named)}")
    assert [mutant.name for mutant in mutants if mutant.name not in named] == []


def test_a_wrong_field_fails_alone(k1, mutants, failures):
    fields = k1.trial.symmetry.groups["critic"].names
    for mutant in mutants:
        if mutant.entry[0] in fields:
            assert failures[mutant.name] == list(mutant.entry), mutant.name


WRONGLY_STATED = {
    "base_ang_vel": "trivial + sign + trivial",
    "ball_position": "trivial + trivial + trivial",
    "joint_vel": "actions x sign",
    "foot_height": "trivial + trivial",
    "foot_contact_forces": "(trivial + sign + trivial) x regular",
}


@pytest.mark.parametrize("name", WRONGLY_STATED)
def test_a_term_that_states_a_wrong_representation_fails_alone(k1, name):
    def stating(field: Field) -> Field:
        stated = WRONGLY_STATED[name] if field.name == name else field.term.representation
        return replace(field, term=replace(field.term, representation=stated))

    task = k1.trial.task
    groups = {group: tuple(map(stating, fields)) for group, fields in task.groups.items()}
    standard = load(RepresentationSpec, find("standard", "representations"))
    symmetry = symmetry_of(replace(task, groups=groups), standard)
    assert [row.name for row in k1.rows(symmetry) if row.failed] == [name]


def test_a_check_of_the_tables_against_themselves_catches_none(k1, mutants):
    network = k1.trial.method.spec.network.model_copy(update={"actor_hidden": (16,)})
    method = k1.trial.method.spec.model_copy(update={"network": network})
    caught = [mutant.name for mutant in mutants if not self_consistent(mutant, method)]
    print(f"\n{len(mutants)} mutants: rho^2 = 1 and network equivariance catch {len(caught)}")
    assert not caught


def test_the_dynamics_alone_catch_every_wrong_joint(k1):
    """States mirrored by the wrong table itself, as they are where geometry gives no other."""
    chosen = k1.trial
    env, other = (KickEnv(chosen.task, make_engine(chosen.task, 32, num_threads=1), 0) for _ in range(2))
    actions = torch.randn(32, env.num_actions, generator=torch.Generator().manual_seed(1))
    for _ in range(5):
        env.advance(actions)
    start = env.snapshot()

    def error(image: Image) -> float:
        """Median over the worlds of the largest velocity error after one step."""
        reflection = Reflection.of(chosen.task, image)
        env.restore(start)
        other.restore(reflection(start))
        env.advance(actions)
        other.advance(reflection.actions(actions))
        off = (reflection.qvel(env.engine.qvel) - other.engine.qvel).abs().amax(dim=1)
        return float(off.median())

    assert error(chosen.task.robot.spec.symmetry.image()) < 1e-9
    errors = {mutant.name: error(mutant.image) for mutant in joint_mutants(chosen)}
    assert min(errors.values()) > 1e-3, min(errors, key=lambda name: errors[name])
