import pytest
import torch
import torch.distributed
import torch.multiprocessing
from rsl_rl.modules import EmpiricalNormalization

from kickbench.nets import SymmetricNormalization
from kickbench.symmetry import REGULAR, REGULAR_SIGN, SIGN, TRIVIAL, direct_sum, tensor
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
