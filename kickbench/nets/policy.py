"""A trained network as a function from observations to actions, for torch and numpy."""

from __future__ import annotations

from typing import overload

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor


class TrainedPolicy:
    """The deterministic policy of an actor network.

    Attributes:
        network: The network, in evaluation mode.
    """

    def __init__(self, network: MLPModel) -> None:
        self.network = network.eval()

    @overload
    def __call__(self, observations: TensorDict | Tensor) -> Tensor: ...

    @overload
    def __call__(self, observations: np.ndarray) -> np.ndarray: ...

    def __call__(self, observations: TensorDict | Tensor | np.ndarray) -> Tensor | np.ndarray:
        """Actions of observations.

        Args:
            observations: What an env returns, by group {"actor": [B, n], ...}, or the actor's alone [..., n].

        Returns:
            Actions [..., nu], float32: a numpy array for one, else a tensor.

        Raises:
            ValueError: The observations have another width.
        """
        if isinstance(observations, np.ndarray):
            with torch.inference_mode():
                return self(torch.from_numpy(np.asarray(observations, dtype=np.float32))).numpy()
        if isinstance(observations, TensorDict):
            return self.network(observations)
        width = self.network.obs_dim
        if observations.shape[-1:] != (width,):
            raise ValueError(f"expected observations [..., {width}], found {list(observations.shape)}")
        flat = observations.float().reshape(-1, width)
        actions = self.network(TensorDict({"actor": flat}, batch_size=[len(flat)]))
        return actions.view(*observations.shape[:-1], -1)
