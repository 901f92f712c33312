"""Observation statistics and action noise that commute with the mirror."""

import pytest
import torch
import torch.distributed
import torch.multiprocessing
from rsl_rl.modules import EmpiricalNormalization, GaussianDistribution
from tensordict import TensorDict

from kickbench.nets.modules import Augmentation, SymmetricNormalization, TiedGaussianDistribution
from kickbench.symmetry.representation import REGULAR, REGULAR_SIGN, SIGN, TRIVIAL, direct_sum, tensor
from kickbench.symmetry.torch_ops import Mirror

REPRESENTATION = direct_sum([TRIVIAL, SIGN, REGULAR, REGULAR_SIGN, tensor(REGULAR, TRIVIAL + SIGN + TRIVIAL)])
MIRROR = Mirror(REPRESENTATION)


def batches(n: int = 5) -> list[torch.Tensor]:
    torch.manual_seed(0)
    scale = torch.rand(REPRESENTATION.dim) * 3
    offset = torch.randn(REPRESENTATION.dim) * 2  # one-sided data, as from a home field
    return [torch.randn(331 + i, REPRESENTATION.dim) * scale + offset for i in range(n)]


def trained() -> SymmetricNormalization:
    normalizer = SymmetricNormalization(REPRESENTATION)
    for x in batches():
        normalizer.update(x)
    return normalizer


def test_statistics_are_those_of_the_samples_and_their_mirror_images():
    stock = EmpiricalNormalization(REPRESENTATION.dim)
    for x in batches():
        stock.update(torch.cat((x, MIRROR(x))))
    state = dict(trained().state_dict())
    assert 2 * state.pop("count") == stock.state_dict().pop("count")
    torch.testing.assert_close(state, {name: stock.state_dict()[name] for name in state})


def test_the_mean_of_a_sign_coordinate_is_exactly_zero():
    assert trained().mean[1] == 0.0
    assert trained().mean[0].abs() > 0.1


def test_a_regular_pair_shares_mean_and_deviation_to_the_last_bit():
    mean, std = trained().mean, trained().std
    assert mean[2] == mean[3] != 0.0
    assert std[2] == std[3]


def test_a_regular_sign_pair_has_opposite_means_and_the_same_deviation():
    mean, std = trained().mean, trained().std
    assert mean[4] == -mean[5] != 0.0
    assert std[4] == std[5]


def test_the_whole_mean_is_invariant_to_the_last_bit():
    mean, std = trained().mean, trained().std
    assert torch.equal(MIRROR(mean), mean)
    assert torch.equal(std[MIRROR.permutation], std)


def test_normalising_commutes_with_the_mirror_to_the_last_bit():
    normalizer, x = trained(), torch.randn(64, REPRESENTATION.dim)
    assert torch.equal(normalizer(MIRROR(x)), MIRROR(normalizer(x)))


def test_the_stock_normaliser_would_not_commute():
    stock, x = EmpiricalNormalization(REPRESENTATION.dim), torch.randn(64, REPRESENTATION.dim)
    for batch in batches():
        stock.update(batch)
    assert (stock(MIRROR(x)) - MIRROR(stock(x))).abs().max() > 0.1


def test_checkpoints_have_the_keys_of_the_stock_normaliser():
    stock = EmpiricalNormalization(REPRESENTATION.dim)
    stock.load_state_dict(trained().state_dict())
    torch.testing.assert_close(stock.mean, trained().mean)


def test_evaluation_mode_learns_nothing():
    normalizer = trained().eval()
    before = normalizer.mean
    normalizer.update(batches()[0] + 5)
    assert torch.equal(normalizer.mean, before)


def test_learning_stops_after_until_samples():
    normalizer = SymmetricNormalization(REPRESENTATION, until=300)
    first, second = batches(2)
    normalizer.update(first)  # 331 samples
    before = normalizer.mean
    normalizer.update(second)
    assert torch.equal(normalizer.mean, before)


def _learn_on_one_rank(rank: int, address: str, queue) -> None:
    torch.distributed.init_process_group("gloo", init_method=address, rank=rank, world_size=2)
    normalizer = SymmetricNormalization(REPRESENTATION)
    for x in batches(4):
        normalizer.update(x[rank::2])
    queue.put((normalizer.mean.tolist(), normalizer.std.tolist()))
    torch.distributed.destroy_process_group()


@pytest.mark.skipif(not torch.distributed.is_available(), reason="torch was built without distributed")
def test_two_processes_learn_the_same_statistics_as_one(tmp_path):
    context = torch.multiprocessing.get_context("fork")
    queue = context.Queue()
    address = f"file://{tmp_path}/rendezvous"
    ranks = [context.Process(target=_learn_on_one_rank, args=(rank, address, queue)) for rank in range(2)]
    for process in ranks:
        process.start()
    results = [queue.get(timeout=30) for _ in ranks]
    for process in ranks:
        process.join(timeout=30)
    assert results[0] == results[1]
    alone = SymmetricNormalization(REPRESENTATION)
    for x in batches(4):
        alone.update(x)
    torch.testing.assert_close(
        torch.tensor(results[0]), torch.stack((alone.mean, alone.std)), atol=1e-5, rtol=1e-5
    )


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


def test_an_unknown_std_type_is_refused():
    with pytest.raises(ValueError, match="Should be 'scalar' or 'log'"):
        TiedGaussianDistribution(6, ACTION, std_type="softplus")


OBSERVATIONS = {"actor": tensor(REGULAR, TRIVIAL + SIGN), "critic": TRIVIAL + SIGN + REGULAR_SIGN}
SAMPLED_ACTION = SIGN + REGULAR + REGULAR_SIGN
AUGMENT = Augmentation(OBSERVATIONS, SAMPLED_ACTION)
N = 6


def observations() -> TensorDict:
    return TensorDict({k: torch.randn(N, r.dim) for k, r in OBSERVATIONS.items()}, batch_size=[N])


def test_mirror_images_follow_the_originals_as_the_tables_say():
    obs, actions = observations(), torch.randn(N, SAMPLED_ACTION.dim)
    more_obs, more_actions = AUGMENT(env=None, obs=obs, actions=actions)
    assert more_obs.batch_size == (2 * N,)
    for group, representation in OBSERVATIONS.items():
        rho = torch.tensor(representation.matrix(), dtype=torch.float32)
        torch.testing.assert_close(more_obs[group], torch.cat((obs[group], obs[group] @ rho.T)))
    rho = torch.tensor(SAMPLED_ACTION.matrix(), dtype=torch.float32)
    torch.testing.assert_close(more_actions, torch.cat((actions, actions @ rho.T)))


def test_augmenting_mirror_images_gives_the_originals_back():
    (obs, actions) = observations(), torch.randn(N, SAMPLED_ACTION.dim)
    mirrored_obs, mirrored_actions = AUGMENT(None, obs, actions)
    twice_obs, twice_actions = AUGMENT(None, mirrored_obs[N:], mirrored_actions[N:])
    torch.testing.assert_close(twice_actions[N:], actions)
    torch.testing.assert_close(twice_obs[N:]["actor"], obs["actor"])


def test_none_stays_none():
    assert AUGMENT(None, None, None) == (None, None)
    assert AUGMENT(None, observations(), None)[1] is None
    assert AUGMENT(None, None, torch.randn(N, SAMPLED_ACTION.dim))[0] is None
