"""Threads of torch."""

from __future__ import annotations

import pytest
import torch

from kickbench.nets.threads import torch_threads, update_threads


def test_wide_networks_update_on_all_cores_and_narrow_ones_on_one(experiment):
    narrow = experiment("mini_home_field", "baseline").method.spec
    wide = experiment("mini_home_field", "baseline", "network.critic_hidden=[512, 64]").method.spec
    assert update_threads(narrow, 8) == 1
    assert update_threads(wide, 8) == 8


def test_the_number_of_threads_is_restored_even_after_an_error():
    before = torch.get_num_threads()

    def fail_with_other_threads() -> None:
        with torch_threads(before + 1):
            assert torch.get_num_threads() == before + 1
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fail_with_other_threads()
    assert torch.get_num_threads() == before
