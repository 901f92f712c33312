"""From a trained run to an ONNX file of plain layers and its contract."""

from __future__ import annotations

import hashlib
import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

from kickbench import __version__
from kickbench.deploy.contract import (
    Action,
    Contract,
    Delay,
    Joint,
    Mirror,
    Observation,
    Origin,
    SignedPermutation,
    Training,
)
from kickbench.errors import KickbenchError, shown
from kickbench.evaluate.episodes import draw_starts
from kickbench.mdp.compile import CompiledTask, Field
from kickbench.nets.policy import TrainedPolicy
from kickbench.results.atomic import atomic_file, atomic_write_bytes, atomic_write_text, check_writable
from kickbench.results.identity import read_identity
from kickbench.spec.terms import TerminationParams
from kickbench.symmetry.representation import Representation
from kickbench.train.trained import Run, load_run
from kickbench.view.extra import require

OPSET = 13
"""ONNX operators of 2020: every runtime reads them."""
_COMPONENTS = {
    2: ("left", "right"),
    3: ("x", "y", "z"),
    6: tuple(f"{s}_{a}" for s in ("left", "right") for a in "xyz"),
}


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
        KickbenchError: The run has no policy or is damaged, a policy is in the way, or a library is missing.
    """
    require("onnx", "an export", "deploy")
    loaded = load_run(run)
    origin = loaded.metrics
    folder = Path(folder or Path("exported", origin.task, origin.method, f"seed{origin.seed}"))
    if not force and (there := [name for name in ("policy.onnx", "policy.json") if (folder / name).exists()]):
        raise KickbenchError(f"{shown(folder)}: holds {' and '.join(there)}; --force overwrites")
    contract = contract_of(loaded)
    network = onnx_bytes(loaded.policy, contract)
    check_writable(folder / "policy.onnx")
    if states:
        _write_states(folder / "initial_states.npz", loaded.experiment.task, states)
    atomic_write_bytes(folder / "policy.onnx", network)
    atomic_write_text(folder / "policy.json", contract.text())
    return folder


def onnx_bytes(policy: TrainedPolicy, contract: Contract) -> bytes:
    """The policy as an ONNX file with the contract as metadata; equal policies give equal bytes."""
    onnx = require("onnx", "an export", "deploy")
    module, buffer = policy.network.as_onnx(verbose=False).eval(), io.BytesIO()
    with warnings.catch_warnings():
        # The exporter that torch prefers since 2.9 writes operators that runtimes before 2022 cannot read.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            module,
            (torch.zeros(1, policy.network.obs_dim),),
            buffer,
            input_names=[contract.input],
            output_names=[contract.output],
            dynamic_axes={contract.input: {0: "batch"}, contract.output: {0: "batch"}},
            opset_version=OPSET,
            dynamo=False,
        )
    model = onnx.load_model_from_string(buffer.getvalue())
    onnx.checker.check_model(model)
    onnx.helper.set_model_props(model, {"kickbench": contract.text()})
    return model.SerializeToString(deterministic=True)


def contract_of(run: Run) -> Contract:
    """The contract of a run's policy.

    Raises:
        KickbenchError: The run has no result or no identity.
    """
    experiment, specs = run.experiment, run.specs
    task, robot = experiment.task, specs.robot
    layout, symmetry = task.scene.layout, experiment.symmetry
    actuators = zip(robot.actuators.items(), layout.default_target.tolist(), strict=True)
    return Contract(
        base=robot.base,
        control_interval=task.spec.simulation.control_interval,
        observations=tuple(_observation(task, field) for field in task.groups["actor"]),
        joints=tuple(_joints(task)),
        actions=tuple(
            Action(**spec.model_dump(), name=name, default=default) for (name, spec), default in actuators
        ),
        mirror=Mirror(
            observations=_signed(symmetry.groups["actor"].representation),
            actions=_signed(symmetry.actions),
            equivariant=specs.method.network.type == "equivariant",
        ),
        training=_training(task),
        origin=_origin(run),
    )


def _observation(task: CompiledTask, field: Field) -> Observation:
    term, layout = field.bound.term, task.scene.layout
    named = {"joints": layout.joint_names, "actions": layout.actuator_names}
    components = (
        named.get(str(term.size)) or _COMPONENTS.get(field.size) or tuple(map(str, range(field.size)))
    )
    default = layout.default_qpos[layout.joint_qpos]
    offset = default if term.from_default else np.zeros(field.size)
    return Observation(
        name=field.name,
        description=" ".join(term.description.split()),
        units=term.units,
        frame=term.frame,
        components=components,
        offset=tuple(offset.tolist()),
        scale=(1.0,) * field.size,
        clip=field.params.clip,
        noise=field.params.noise,
    )


def _joints(task: CompiledTask) -> list[Joint]:
    layout = task.scene.layout
    defaults = layout.default_qpos[layout.joint_qpos].tolist()
    return [
        Joint(name=name, default=default, range=tuple(bounds.tolist()) if np.isfinite(bounds).all() else None)
        for name, default, bounds in zip(layout.joint_names, defaults, layout.joint_range, strict=True)
    ]


def _training(task: CompiledTask) -> Training:
    spec = task.spec
    delay: Any = next((bound.params for bound in task.processes if bound.term.stage == "command"), None)
    endings = spec.terminations.active(TerminationParams)
    return Training(
        simulation=spec.simulation,
        ball=spec.ball,
        floor=spec.floor,
        feet=task.robot.spec.feet,
        episode=spec.episode,
        terminations={name: params.model_dump() for name, params in endings.items()},
        success_radius=spec.evaluation.success_radius,
        action_delay=delay and Delay(delay=delay.delay, hold_probability=delay.hold_probability),
    )


def _origin(run: Run) -> Origin:
    metrics, directory = run.metrics, run.directory
    return Origin(
        kickbench=__version__,
        trained_with=metrics.provenance.versions,
        task=metrics.task,
        method=metrics.method,
        seed=metrics.seed,
        samples=metrics.env_steps,
        identity=read_identity(directory).fingerprint,
        policy=hashlib.sha256(directory.policy.read_bytes()).hexdigest(),
    )


def _signed(representation: Representation) -> SignedPermutation:
    return SignedPermutation(index=representation.permutation, sign=representation.signs)


def _write_states(path: Path, task: CompiledTask, count: int) -> None:
    """The initial states of the task's evaluation: those that `kickbench eval --episodes <count>` runs."""
    starts = draw_starts(task, count, task.spec.evaluation.seed)
    arrays = {"qpos": starts.qpos, "qvel": starts.qvel, "target": starts.target, **starts.by_side}
    with atomic_file(path) as file:
        np.savez(file, **{name: values.numpy() for name, values in arrays.items()})
