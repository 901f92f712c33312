"""What reaches the policy of its fields, and when: sampled at a rate, late, and now and then lost."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from kickbench.envs.disturbances import Setting, uniform
from kickbench.envs.tensors import Tensors
from kickbench.envs.term import Field

_ROUNDING = 1e-6
"""What a number of control steps may lack to be whole, by rounding."""


class Sampler:
    """Samples one field: `rate`, `dropout` and `delay` of `ObservationParams`, in this order.

    The k-th sample, at k / rate seconds into the episode, is that of the first control step at or after that
    time. It is lost with the probability `dropout`; the last sample that was not lost is held. What is held
    is seen `delay` seconds later, rounded up to whole control steps. The first sample, of the initial state,
    is never lost, and has been seen when the episode begins.

    At 50 control steps a second, a rate of 16 Hz samples at control steps 0, 4, 7, 10, 13, 16, 19, 22, 25, 29;
    with a delay of 0.06 s, control steps 7, 8 and 9 see the sample of step 4.

    Attributes:
        name: The field's name.
        memory: Its tensors: `history`, the last sample that was not lost, at this control step and those
            before it, newest first [B, depth, size]; `age`, the delay of the running episode [B], control
            steps; `step`, the control step of the newest entry [B], -1 after a reset, before the first one.
    """

    def __init__(self, field: Field, setting: Setting) -> None:
        """Makes room for the longest delay."""
        self.name = field.name
        params, interval = field.params, setting.timestep * setting.decimation
        self._delay = tuple(seconds / interval for seconds in params.delay or (0.0, 0.0))
        self._dropout = params.dropout or 0.0
        self._samples_a_step = params.rate * interval if params.rate else 1.0
        self._generator, envs = setting.generator, setting.num_envs
        depth, device = math.ceil(self._delay[1] - _ROUNDING) + 1, setting.default_target.device
        whole = {"dtype": torch.int64, "device": device}
        self.memory = Tensors(
            history=torch.zeros(envs, depth, field.size, device=device),
            age=torch.zeros(envs, **whole),
            step=torch.full((envs,), -1, **whole),
        )
        # Place of every env's newest entry in the flattened history.
        self._first = depth * torch.arange(envs, device=device)

    def reset(self, mask: Tensor) -> None:
        """Forgets the samples of the envs in `mask` [B] and draws their delays."""
        memory, (low, high) = self.memory, self._delay
        memory.step = torch.where(mask, -1, memory.step)
        if low < high:
            drawn = low + (high - low) * uniform(self._generator, mask.shape, env_axis=0)
            # Rounded up to whole control steps; float32 knows few digits of them.
            whole = (drawn - 1e-4).ceil().long().clamp(0, memory.history.shape[1] - 1)
            memory.age = torch.where(mask, whole, memory.age)
        else:
            memory.age.fill_(math.ceil(high - _ROUNDING))

    def __call__(self, value: Tensor, step: Tensor) -> Tensor:
        """What is seen of a field; a second look within a control step sees the same.

        Args:
            value: The exact value now [B, size].
            step: Control steps since the initial state [B].
        """
        memory, history = self.memory, self.memory.history
        arrives = self._count(step) > self._count(step - 1)
        if self._dropout:
            arrives &= uniform(self._generator, step.shape, env_axis=0) >= self._dropout
        held = torch.where(arrives.unsqueeze(1), value, history[:, 0])
        longer = torch.cat([held.unsqueeze(1), history[:, :-1]], dim=1)
        is_later, is_first = (part.view(-1, 1, 1) for part in (step != memory.step, memory.step < 0))
        history = torch.where(is_later, longer, history)
        memory.history = torch.where(is_first, value.unsqueeze(1), history)
        memory.step = step
        return memory.history.flatten(0, 1).index_select(0, self._first + memory.age)

    def _count(self, step: Tensor) -> Tensor:
        """Samples since the first, up to and including a control step [B]."""
        return (step.double() * self._samples_a_step + _ROUNDING).floor()


def make_samplers(fields: Sequence[Field], setting: Setting) -> dict[str, Sampler]:
    """A sampler for each field whose parameters ask for one, by `Field.key`."""
    return {field.key: Sampler(field, setting) for field in fields if field.params.is_sampled}
