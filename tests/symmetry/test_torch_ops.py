import pytest
import torch

from kickbench.symmetry.representation import BY_NAME, REGULAR_SIGN, SIGN, TRIVIAL, regular
from kickbench.symmetry.torch_ops import Mirror


@pytest.mark.parametrize(
    "representation", [*BY_NAME.values(), TRIVIAL + REGULAR_SIGN + SIGN, regular(3)], ids=str
)
@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_mirror_is_the_representation_matrix_on_the_last_axis(representation, shape):
    x = torch.randn(*shape, representation.dim, dtype=torch.float64)
    torch.testing.assert_close(Mirror(representation)(x), x @ torch.from_numpy(representation.matrix()).T)


@pytest.mark.parametrize("representation", BY_NAME.values(), ids=str)
def test_mirror_returns_a_new_tensor(representation):
    x = torch.ones(representation.dim)
    Mirror(representation)(x).zero_()
    assert x.sum() == representation.dim


def test_mirror_leaves_no_trace_in_checkpoints():
    assert Mirror(REGULAR_SIGN).state_dict() == {}
