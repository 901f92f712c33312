import pytest
import torch
from rsl_rl.modules import GaussianDistribution

from kickbench.nets import TiedGaussianDistribution
from kickbench.symmetry import REGULAR, REGULAR_SIGN, SIGN, TRIVIAL

ACTION = TRIVIAL + SIGN + REGULAR + REGULAR_SIGN


def randomised(std_type: str) -> TiedGaussianDistribution:
    distribution = TiedGaussianDistribution(6, ACTION, std_type=std_type)
    with torch.no_grad():
        for parameter in distribution.parameters():
            parameter.uniform_(0.1, 0.9)
    return distribution


@pytest.mark.parametrize("std_type", ["scalar", "log"])
def test_mirrored_actions_share_their_standard_deviation(std_type):
    distribution = randomised(std_type)
    distribution.update(torch.zeros(3, 6))
    trivial, sign, left, right, left_sign, right_sign = distribution.std[0].tolist()
    assert left == right
    assert left_sign == right_sign
    assert len({trivial, sign, left, left_sign}) == 4


@pytest.mark.parametrize("std_type", ["scalar", "log"])
def test_there_is_one_parameter_for_each_orbit(std_type):
    (parameter,) = randomised(std_type).parameters()
    assert parameter.shape == (4,)


@pytest.mark.parametrize("std_type", ["scalar", "log"])
def test_it_starts_and_evaluates_like_the_gaussian_of_rsl_rl(std_type):
    tied = TiedGaussianDistribution(6, ACTION, init_std=0.6, std_type=std_type)
    stock = GaussianDistribution(6, init_std=0.6, std_type=std_type)
    mean, actions = torch.randn(5, 6), torch.randn(5, 6)
    tied.update(mean)
    stock.update(mean)
    for quantity in ("mean", "std", "entropy", "params"):
        torch.testing.assert_close(getattr(tied, quantity), getattr(stock, quantity))
    torch.testing.assert_close(tied.log_prob(actions), stock.log_prob(actions))
    assert tied.input_dim == 6
    assert tied.sample().shape == (5, 6)


@pytest.mark.parametrize("std_type", ["scalar", "log"])
def test_the_standard_deviation_stays_in_its_range(std_type):
    distribution = TiedGaussianDistribution(6, ACTION, init_std=5.0, std_range=(0.1, 0.5), std_type=std_type)
    distribution.update(torch.zeros(2, 6))
    torch.testing.assert_close(distribution.std, torch.full((2, 6), 0.5))


def test_a_fixed_standard_deviation_is_not_learned():
    (parameter,) = TiedGaussianDistribution(6, ACTION, learn_std=False).parameters()
    assert not parameter.requires_grad


def test_both_members_of_a_pair_train_their_shared_parameter():
    distribution = TiedGaussianDistribution(6, ACTION)
    distribution.update(torch.zeros(1, 6))
    distribution.std[0, 2:4].sum().backward()
    assert distribution.std_param.grad.tolist() == [0, 0, 2, 0]


def test_the_representation_must_fit_the_actions():
    with pytest.raises(ValueError, match="7 actions, but their representation has 6 dimensions"):
        TiedGaussianDistribution(7, ACTION)


def test_an_unknown_std_type_is_refused():
    with pytest.raises(ValueError, match="Should be 'scalar' or 'log'"):
        TiedGaussianDistribution(6, ACTION, std_type="softplus")
