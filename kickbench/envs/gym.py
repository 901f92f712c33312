"""Tasks as Gymnasium vector envs.

Use: `import kickbench.envs.gym`, then `gymnasium.make_vec("kickbench/<task>")`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from kickbench.config.shipped import names
from kickbench.envs.env import KickEnv, make
from kickbench.errors import require

require("gymnasium", "kickbench.envs.gym", "gym")
from gymnasium import register, registry, spaces  # noqa: E402 (first the message that says what to install)
from gymnasium.vector import AutoresetMode, VectorEnv  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402


class KickVectorEnv(VectorEnv):
    """B envs of a task, numpy in and out: the actor's observations, rewards and endings of `KickEnv`.

    Envs reset in the step that ends their episode (`AutoresetMode.SAME_STEP`): the observation is then the
    first of the next episode; `infos["final_obs"]` has the last of the ended one, and `infos["final_info"]`
    whether it was a `success` and the `distance` of ball and target, m. A time limit truncates; every other
    ending terminates, and so does a state that is not finite, whose final observation is as it is.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, task: Path | str, num_envs: int = 1, *, seed: int = 0, **options: Any) -> None:
        """Makes the envs; arguments as for `kickbench.make`, on the CPU."""
        self._begin(make(task, num_envs, seed, device="cpu", **options), seed)
        self.num_envs, width = num_envs, self.env.task.width("actor")
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (width,), np.float32)
        self.single_action_space = spaces.Box(-np.inf, np.inf, (self.env.num_actions,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def _begin(self, env: KickEnv, seed: int) -> None:
        self.env = env
        # Noise and lost samples of final observations, which a `KickEnv` does not draw: its own numbers stay
        # what they are.
        self._draws = torch.Generator().manual_seed(seed)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins a new episode in every env; with a seed all that follows is determined by it."""
        super().reset(seed=seed)
        if options:
            raise ValueError(f"no options are known, found {sorted(options)}")
        if seed is None:
            self.env.reset()
        else:
            self._begin(KickEnv(self.env.task, self.env.engine, seed), seed)
        return _array(self.env.get_observations()["actor"]), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advances every env by one control step."""
        if np.shape(actions) != self.action_space.shape:
            raise ValueError(f"expected actions {self.action_space.shape}, found {np.shape(actions)}")
        state = self.env.advance(torch.tensor(actions, dtype=torch.float32))
        # Now: the end of a step overwrites the episodes and what their actors have sampled.
        final = _array(self.env.observations_of(state, self._draws)["actor"])
        observations, rewards, done, extras = self.env.finish(state)
        infos = self._endings(final, _array(done)) if done.any() else dict[str, Any]()
        truncated = _array(extras["time_outs"])
        terminated = _array(done) & ~truncated
        return _array(observations["actor"]), _array(rewards), terminated, truncated, infos

    def _endings(self, final: np.ndarray, done: np.ndarray) -> dict[str, Any]:
        """What Gymnasium says of envs that are reset in the same step."""
        outcome, infos = self.env.outcome, dict[str, Any]()
        assert outcome is not None
        for env in np.flatnonzero(done).tolist():
            facts = {"success": bool(outcome.success[env]), "distance": float(outcome.distance[env])}
            infos = self._add_info(infos, {"final_obs": final[env], "final_info": facts}, env)
        return infos


def _array(tensor: torch.Tensor) -> np.ndarray:
    """A copy, which nobody else writes to."""
    return tensor.numpy().copy()


for _name, _path in names("task").items():
    if (_id := f"kickbench/{Path(_name).name}") not in registry:
        register(
            _id, vector_entry_point="kickbench.envs.gym:KickVectorEnv", kwargs={"task": str(_path.resolve())}
        )
