import torch
from tensordict import TensorDict

from kickbench.nets.augmentation import Augmentation
from kickbench.symmetry.representation import REGULAR, REGULAR_SIGN, SIGN, TRIVIAL, tensor

OBSERVATIONS = {"actor": tensor(REGULAR, TRIVIAL + SIGN), "critic": TRIVIAL + SIGN + REGULAR_SIGN}
ACTION = SIGN + REGULAR + REGULAR_SIGN
AUGMENT = Augmentation(OBSERVATIONS, ACTION)
N = 6


def observations() -> TensorDict:
    return TensorDict({k: torch.randn(N, r.dim) for k, r in OBSERVATIONS.items()}, batch_size=[N])


def test_mirror_images_follow_the_originals_as_the_tables_say():
    obs, actions = observations(), torch.randn(N, ACTION.dim)
    more_obs, more_actions = AUGMENT(env=None, obs=obs, actions=actions)
    assert more_obs.batch_size == (2 * N,)
    for group, representation in OBSERVATIONS.items():
        rho = torch.tensor(representation.matrix(), dtype=torch.float32)
        torch.testing.assert_close(more_obs[group], torch.cat((obs[group], obs[group] @ rho.T)))
    rho = torch.tensor(ACTION.matrix(), dtype=torch.float32)
    torch.testing.assert_close(more_actions, torch.cat((actions, actions @ rho.T)))


def test_augmenting_mirror_images_gives_the_originals_back():
    (obs, actions) = observations(), torch.randn(N, ACTION.dim)
    mirrored_obs, mirrored_actions = AUGMENT(None, obs, actions)
    twice_obs, twice_actions = AUGMENT(None, mirrored_obs[N:], mirrored_actions[N:])
    torch.testing.assert_close(twice_actions[N:], actions)
    torch.testing.assert_close(twice_obs[N:]["actor"], obs["actor"])


def test_none_stays_none():
    assert AUGMENT(None, None, None) == (None, None)
    assert AUGMENT(None, observations(), None)[1] is None
    assert AUGMENT(None, None, torch.randn(N, ACTION.dim))[0] is None
