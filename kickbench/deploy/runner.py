"""Runs an exported policy; needs numpy and onnxruntime alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kickbench.errors import KickbenchError, require, shown


class Policy:
    """An exported policy with its contract.

    `step` is all that a control loop needs; call `reset` when an episode begins. The parts that it is made of
    take batches: `observation`, the call itself, `targets`, and `mirror`.

    Attributes:
        contract: What `policy.json` holds (`kickbench.deploy.contract` describes it).
        action: The last action of `step` [nu].
    """

    def __init__(self, path: Path | str) -> None:
        """Loads a policy.

        Args:
            path: `policy.onnx`, or the folder that holds it.

        Raises:
            KickbenchError: It is missing, damaged or not from kickbench, or onnxruntime is not installed.
        """
        runtime = require("onnxruntime", "an exported policy", "deploy")
        file = Path(path, "policy.onnx") if Path(path).is_dir() else Path(path)
        if not file.is_file():
            raise KickbenchError(f"{shown(file)}: no such file; `kickbench export RUN` writes one")
        try:
            self._session = runtime.InferenceSession(file.read_bytes(), providers=["CPUExecutionProvider"])
            metadata = self._session.get_modelmeta().custom_metadata_map
        except Exception as error:  # onnxruntime's exceptions have no common class
            raise KickbenchError(f"{shown(file)}: damaged: {' '.join(str(error).split())}") from None
        self.contract: dict[str, Any] = json.loads(metadata.get("kickbench", "{}"))
        if self.contract.get("format") != 1:
            raise KickbenchError(f"{shown(file)}: expected a policy with a contract of format 1")
        fields, actions = self.contract["observations"], self.contract["actions"]
        self._sizes = {field["name"]: len(field["components"]) for field in fields}
        self._offset, self._gain = (np.concatenate([f[key] for f in fields]) for key in ("offset", "scale"))
        self._clip = _bounds([field["clip"] for field in fields for _ in field["components"]])
        self._default, self._scale = (np.array([a[key] for a in actions]) for key in ("default", "scale"))
        self._limits = _bounds([action["limits"] for action in actions])
        self.reset()

    def reset(self) -> None:
        """Begins an episode: the previous action is 0."""
        self.action = np.zeros(len(self._default), dtype=np.float32)

    def step(self, values: Mapping[str, Any]) -> np.ndarray:
        """Targets of the actuators [nu] for one control step.

        Args:
            values: Value of every observation by name, as the contract describes it, but `previous_action`.
        """
        previous = {"previous_action": self.action} if "previous_action" in self._sizes else {}
        self.action = self(self.observation({**previous, **values}))
        return self.targets(self.action)

    def observation(self, values: Mapping[str, Any]) -> np.ndarray:
        """The observation vector [..., n] of values by name [..., components], float32.

        Raises:
            ValueError: A value is missing, is not in the contract, has another size, or is NaN or infinite.
        """
        arrays = {name: np.atleast_1d(value) for name, value in values.items()}
        sizes = {name: array.shape[-1] for name, array in arrays.items()}
        if sizes != self._sizes:
            raise ValueError(f"expected observations of the sizes {self._sizes}, found {sizes}")
        if broken := [name for name, array in arrays.items() if not np.isfinite(array).all()]:
            raise ValueError(f"expected finite numbers; NaN or infinite: {', '.join(broken)}")
        vector = np.concatenate([arrays[name] for name in self._sizes], axis=-1)
        return np.clip((vector - self._offset) * self._gain, *self._clip).astype(np.float32)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Actions [..., nu] of observation vectors [..., n], float32."""
        rows = np.asarray(observations, dtype=np.float32).reshape(-1, len(self._offset))
        actions = self._session.run([self.contract["output"]], {self.contract["input"]: rows})[0]
        return actions.reshape(*np.shape(observations)[:-1], -1)

    def targets(self, actions: np.ndarray) -> np.ndarray:
        """Targets of the actuators [..., nu] of actions [..., nu], within their limits."""
        return np.clip(self._default + self._scale * actions, *self._limits)

    def mirror(self, what: str, vectors: np.ndarray) -> np.ndarray:
        """The reflection of vectors [..., n]; `what` is "observations" or "actions"."""
        table = self.contract["mirror"][what]
        return np.asarray(vectors)[..., table["index"]] * np.array(table["sign"], dtype=np.float32)


def _bounds(ranges: list[Any]) -> np.ndarray:
    """Lowest and highest values [2, n]; infinite where there is no range."""
    return np.array([bounds or (-np.inf, np.inf) for bounds in ranges]).T
