"""Runs an exported policy; needs numpy and onnxruntime alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kickbench.errors import KickbenchError, shown
from kickbench.view.extra import require


class Policy:
    """An exported policy with its contract.

    `step` is all that a control loop needs; call `reset` when an episode begins. The parts that it is made of
    take batches: `observation`, the call itself, `targets`, and `mirror`.

    Attributes:
        contract: What `policy.json` holds (`kickbench.deploy.contract.Contract` describes it).
        action: The last action of `step` [nu].
    """

    def __init__(self, path: Path | str) -> None:
        """Loads a policy.

        Args:
            path: `policy.onnx`, or the folder that holds it.

        Raises:
            KickbenchError: It is missing, damaged or none of kickbench's, or onnxruntime is not installed.
        """
        runtime = require("onnxruntime", "an exported policy", "deploy")
        file = Path(path, "policy.onnx") if Path(path).is_dir() else Path(path)
        if not file.is_file():
            raise KickbenchError(f"{shown(file)}: no such file; `kickbench export RUN` writes one")
        try:
            self._session = runtime.InferenceSession(file.read_bytes(), providers=["CPUExecutionProvider"])
            self.contract: dict[str, Any] = json.loads(
                self._session.get_modelmeta().custom_metadata_map["kickbench"]
            )
        except KeyError:
            raise KickbenchError(f"{shown(file)}: not an export of kickbench: it has no contract") from None
        except Exception as error:  # onnxruntime has no common class of errors
            raise KickbenchError(f"{shown(file)}: damaged: {' '.join(str(error).split())}") from None
        if self.contract["format"] != 1:
            raise KickbenchError(f"{shown(file)}: format {self.contract['format']}; this version reads 1")
        fields, self._actions = self.contract["observations"], self.contract["actions"]
        self._fields = {field["name"]: field for field in fields}
        clips = [field["clip"] or (-np.inf, np.inf) for field in fields for _ in field["components"]]
        self._clip = np.array(clips, dtype=np.float32).T
        self._default, self._scale = (
            np.array([actuator[key] for actuator in self._actions]) for key in ("default", "scale")
        )
        limits = [actuator["limits"] or (-np.inf, np.inf) for actuator in self._actions]
        self._limits = np.array(limits).T
        self.reset()

    def reset(self) -> None:
        """Begins an episode: the previous action is 0."""
        self.action = np.zeros(len(self._actions), dtype=np.float32)

    def step(self, values: Mapping[str, Any]) -> np.ndarray:
        """Targets of the actuators [nu] for one control step.

        Args:
            values: Value of every observation by name, as the contract describes it; `previous_action` is known.
        """
        self.action = self(self.observation({"previous_action": self.action, **values}))
        return self.targets(self.action)

    def observation(self, values: Mapping[str, Any]) -> np.ndarray:
        """The observation vector [..., n] of values by name [..., components].

        Raises:
            ValueError: A value is missing, is not in the contract, or has another size.
        """
        given = {name: values[name] for name in values if name in self._fields or name != "previous_action"}
        if set(given) != set(self._fields):
            raise ValueError(f"expected the observations {list(self._fields)}, found {list(given)}")
        return np.clip(
            np.concatenate([self._field(f, given[name]) for name, f in self._fields.items()], axis=-1),
            *self._clip,
        )

    def _field(self, field: Mapping[str, Any], value: Any) -> np.ndarray:
        array = np.asarray(value, dtype=np.float32)
        if array.shape[-1:] != (len(field["components"]),):
            expected = ", ".join(field["components"])
            raise ValueError(f"{field['name']}: expected {expected}, found shape {list(array.shape)}")
        return ((array - field["offset"]) * field["scale"]).astype(np.float32)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Actions [..., nu] of observation vectors [..., n], float32."""
        rows = np.asarray(observations, dtype=np.float32).reshape(-1, self._clip.shape[1])
        actions = self._session.run([self.contract["output"]], {self.contract["input"]: rows})[0]
        return actions.reshape(*np.shape(observations)[:-1], -1)

    def targets(self, actions: np.ndarray) -> np.ndarray:
        """Targets of the actuators [..., nu] of actions [..., nu], within their limits."""
        return np.clip(self._default + self._scale * actions, *self._limits)

    def mirror(self, what: str, vectors: np.ndarray) -> np.ndarray:
        """The reflection of vectors [..., n]; `what` is "observations" or "actions"."""
        table = self.contract["mirror"][what]
        return np.asarray(vectors)[..., table["index"]] * np.array(table["sign"], dtype=np.float32)
