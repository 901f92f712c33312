"""From a trained run to an ONNX file of plain layers and its contract."""

from __future__ import annotations

import hashlib
import io
import warnings
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from kickbench import __version__
from kickbench.config.terms import TerminationParams
from kickbench.deploy import contract as parts
from kickbench.deploy.contract import Contract, SignedPermutation
from kickbench.envs.compiled_task import CompiledTask
from kickbench.envs.term import Field
from kickbench.errors import KickbenchError, require, shown
from kickbench.evaluation.rollouts import draw_initial_states
from kickbench.nets.actor_critic import TrainedPolicy
from kickbench.results.atomic import atomic_file, atomic_write_bytes, atomic_write_text
from kickbench.results.identity import read_identity
from kickbench.sim.layout import SceneLayout
from kickbench.training.trained import Run, load_run
from kickbench.trials.trial import symmetry_of

OPSET = 13
"""ONNX operators of 2020: every runtime reads them."""
_SIDES, _AXES = ("left", "right"), ("x", "y", "z")
_COMPONENTS = {
    "regular": _SIDES,
    "trivial + sign": _AXES[:2],
    "trivial + sign + trivial": _AXES,
    "sign + trivial + sign": _AXES,
}
"""What the numbers of an observation are, by its representation."""


def export(
    run: Path | str, folder: Path | str | None = None, *, states: int = 0, force: bool = False
) -> Path:
    """Writes `policy.onnx` and `policy.json` of a finished run.

    Args:
        run: The run directory.
        folder: Where to write; default: `exported/<task>/<method>/seed<k>`.
        states: Initial states of the run's evaluation to write as `initial_states.npz`, for `sim_to_sim.py`.
        force: Whether to overwrite a policy that is there.

    Returns:
        The folder.

    Raises:
        KickbenchError: The run has no policy or is damaged, the folder has one already, or a library is
            missing.
    """
    require("onnx", "an export", "deploy")
    loaded = load_run(run)
    origin = loaded.metrics
    folder = Path(folder or Path("exported", origin.task, origin.method, f"seed{origin.seed}"))
    if not force and (there := [name for name in ("policy.onnx", "policy.json") if (folder / name).exists()]):
        raise KickbenchError(f"{shown(folder)}: holds {' and '.join(there)}; --force overwrites")
    contract = contract_of(loaded)
    atomic_write_bytes(folder / "policy.onnx", onnx_bytes(loaded.policy, contract))
    atomic_write_text(folder / "policy.json", contract.text())
    if states:
        write_states(folder / "initial_states.npz", loaded.trial.task, states)
    return folder


def onnx_bytes(policy: TrainedPolicy, contract: Contract) -> bytes:
    """The policy as an ONNX file with the contract as metadata; equal policies give equal bytes."""
    onnx = require("onnx", "an export", "deploy")
    module, buffer = policy.network.as_onnx(verbose=False).eval(), cast(Any, io.BytesIO())
    example, name = torch.zeros(1, policy.network.obs_dim), contract.input
    with warnings.catch_warnings():
        # The default exporter since torch 2.9 writes operators that runtimes before 2022 cannot read.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            module, (example,), buffer, input_names=[name], output_names=[contract.output],
            dynamic_axes={name: {0: "batch"}, contract.output: {0: "batch"}},
            opset_version=OPSET, dynamo=False,
        )  # fmt: skip
    model = onnx.load_model_from_string(buffer.getvalue())
    onnx.checker.check_model(model)
    onnx.helper.set_model_props(model, {"kickbench": contract.text()})
    return model.SerializeToString(deterministic=True)


def contract_of(run: Run) -> Contract:
    """The contract of a run's policy.

    Raises:
        KickbenchError: The run has no result or no identity.
    """
    task, robot, method = run.trial.task, run.specs.robot, run.specs.method
    symmetry = symmetry_of(task, run.trial.method.representations)
    layout = task.scene.layout
    joints = layout.joint_names, _default_pose(layout), layout.joint_range.tolist()
    actions = robot.actuators.items(), layout.default_target.tolist()
    mirror = {"observations": symmetry.groups["actor"].representation, "actions": symmetry.actions}
    return Contract(
        base=robot.base,
        control_interval=task.spec.simulation.control_interval,
        observations=tuple(_observation(task, field) for field in task.groups["actor"]),
        joints=tuple(
            parts.Joint(name=name, default=default, range=bounds if np.isfinite(bounds).all() else None)
            for name, default, bounds in zip(*joints, strict=True)
        ),
        actions=tuple(
            parts.Action(**spec.model_dump(), name=name, default=default)
            for (name, spec), default in zip(*actions, strict=True)
        ),
        mirror=parts.Mirror(
            **{name: SignedPermutation(index=r.permutation, sign=r.signs) for name, r in mirror.items()},
            equivariant=method.network.type == "equivariant" and not method.symmetry.exclude,
        ),
        training=_training(task),
        origin=_origin(run),
    )


def _default_pose(layout: SceneLayout) -> tuple[float, ...]:
    return tuple(layout.default_qpos[layout.joint_qpos].tolist())


def _observation(task: CompiledTask, field: Field) -> parts.Observation:
    term, layout = field.term, task.scene.layout
    own = {"joints": layout.joint_names, "actions": layout.actuator_names, "feet": layout.feet}
    own["obstacles"] = tuple(map(str, range(layout.obstacles.observed if layout.obstacles else 0)))
    known = _COMPONENTS | own
    names = known.get(str(term.representation))
    things, _, of_one = str(term.representation).partition(" x ")
    if of_one:
        inner = known.get(of_one.strip("()"), ())
        names = tuple(f"{thing}_{part}" for thing in known.get(things, ()) for part in inner)
    return parts.Observation(
        name=field.name,
        description=" ".join(term.description.split()),
        units=term.units,
        frame=term.frame,
        components=names or tuple(map(str, range(field.size))),
        offset=_default_pose(layout) if term.from_default else (0.0,) * field.size,
        scale=(1.0,) * field.size,
        **{key: getattr(field.params, key) for key in ("clip", "noise", "rate", "dropout", "delay")},
    )


def _training(task: CompiledTask) -> parts.Training:
    spec = task.spec
    delay: Any = next((bound.params for bound in task.processes if bound.term.stage == "command"), None)
    endings = spec.terminations.active(TerminationParams)
    return parts.Training(
        **{name: getattr(spec, name) for name in ("simulation", "ball", "floor", "episode")},
        feet=task.robot.spec.feet,
        terminations={name: params.model_dump() for name, params in endings.items()},
        success_radius=spec.evaluation.success_radius,
        action_delay=delay and parts.Delay(delay=delay.delay, hold_probability=delay.hold_probability),
    )


def _origin(run: Run) -> parts.Origin:
    metrics = run.metrics
    return parts.Origin(
        kickbench=__version__,
        trained_with=metrics.provenance.versions,
        **{name: getattr(metrics, name) for name in ("task", "method", "seed")},
        samples=metrics.env_steps,
        identity=read_identity(run.directory).fingerprint,
        policy=hashlib.sha256(run.directory.policy.read_bytes()).hexdigest(),
    )


def write_states(path: Path, task: CompiledTask, count: int) -> None:
    """The initial states of the task's evaluation: those that `kickbench eval --episodes <count>` runs."""
    starts = draw_initial_states(task, count, task.spec.evaluation.seed)
    arrays = {"qpos": starts.qpos, "qvel": starts.qvel, "target": starts.target, **starts.by_side}
    with atomic_file(path) as file:
        np.savez(file, **{name: values.numpy() for name, values in arrays.items()})  # pyright: ignore
