"""From a trained run to an ONNX file of plain layers and its contract."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from kickbench.deploy.contract import contract_of, contract_text
from kickbench.envs.compiled_task import CompiledTask
from kickbench.errors import KickbenchError, require, shown
from kickbench.evaluation.rollouts import draw_initial_states
from kickbench.nets.actor_critic import TrainedPolicy
from kickbench.results.atomic import atomic_file, atomic_write_bytes, atomic_write_text
from kickbench.training.trained import load_run

OPSET = 13
"""ONNX operators of 2020: every runtime reads them."""


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
    atomic_write_text(folder / "policy.json", contract_text(contract))
    if states:
        write_states(folder / "initial_states.npz", loaded.trial.task, states)
    return folder


def onnx_bytes(policy: TrainedPolicy, contract: dict[str, Any]) -> bytes:
    """The policy as an ONNX file with the contract as metadata; equal policies give equal bytes."""
    onnx = require("onnx", "an export", "deploy")
    module, buffer = policy.network.as_onnx(verbose=False).eval(), cast(Any, io.BytesIO())
    example, names = torch.zeros(1, policy.network.obs_dim), (contract["input"], contract["output"])
    with warnings.catch_warnings():
        # The default exporter since torch 2.9 writes operators that runtimes before 2022 cannot read.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            module, (example,), buffer, input_names=names[:1], output_names=names[1:],
            dynamic_axes={name: {0: "batch"} for name in names}, opset_version=OPSET, dynamo=False,
        )  # fmt: skip
    model = onnx.load_model_from_string(buffer.getvalue())
    onnx.checker.check_model(model)
    onnx.helper.set_model_props(model, {"kickbench": contract_text(contract)})
    return model.SerializeToString(deterministic=True)


def write_states(path: Path, task: CompiledTask, count: int) -> None:
    """The initial states of the task's evaluation: those that `kickbench eval --episodes <count>` runs."""
    starts = draw_initial_states(task, count, task.spec.evaluation.seed)
    arrays = {"qpos": starts.qpos, "qvel": starts.qvel, "target": starts.target, **starts.by_side}
    with atomic_file(path) as file:
        np.savez(file, **{name: values.numpy() for name, values in arrays.items()})  # pyright: ignore
