import pytest

from kickbench.config.method import MethodSpec, SymmetrySpec

METHOD = """\
algorithm: {iterations: 10, num_envs: 4, learning_rate: 1e-3}
network: {type: mlp, actor_hidden: [7, 4], critic_hidden: [5]}
representations: table.yaml
"""


def test_what_is_not_written_has_the_values_of_the_thesis(read):
    method = read(MethodSpec, METHOD)
    algorithm = method.algorithm
    assert (algorithm.steps_per_env, algorithm.epochs, algorithm.mini_batches) == (24, 5, 4)
    assert (algorithm.desired_kl, algorithm.schedule) == (0.01, "adaptive")
    assert (method.network.activation, method.network.initial_std) == ("elu", 1.0)
    assert method.symmetry == SymmetrySpec()
    assert not method.symmetry.augmentation


def test_a_plain_network_may_have_odd_widths(read):
    assert read(MethodSpec, METHOD).network.actor_hidden == (7, 4)


@pytest.mark.parametrize(("actor", "critic", "odd"), [("[8, 7]", "[4]", 7), ("[8]", "[4, 5]", 5)])
def test_an_equivariant_network_has_even_widths(complaints, actor, critic, odd):
    text = METHOD.replace("[7, 4]", actor).replace("[5]", critic).replace("mlp", "equivariant")
    what = f"hidden widths of an equivariant network are even (regular fields); found {odd}"
    assert complaints(MethodSpec, text) == [f"a.yaml:2:1: network: {what}"]


def test_odd_widths_by_override_are_caught_too(complaints):
    even = METHOD.replace("[7, 4]", "[8, 4]").replace("[5]", "[4]")
    (complaint,) = complaints(MethodSpec, even, "network.type=equivariant", "network.actor_hidden=[9]")
    assert complaint.endswith("found 9")


def test_even_widths_make_an_equivariant_network(read):
    text = METHOD.replace("[7, 4]", "[8, 4]").replace("[5]", "[4]").replace("mlp", "equivariant")
    assert read(MethodSpec, text).network.type == "equivariant"


@pytest.mark.parametrize("role", ["actor", "critic"])
def test_hidden_layers_are_not_optional(complaints, role):
    (complaint,) = complaints(MethodSpec, METHOD, f"network.{role}_hidden=[]")
    assert complaint.endswith(f"network.{role}_hidden: expected at least 1 item, found an empty list")


def test_a_width_is_positive(complaints):
    assert complaints(MethodSpec, METHOD.replace("[7, 4]", "[7, 0]")) == [
        "a.yaml:2:40: network.actor_hidden.1: expected a number greater than 0, found the number 0"
    ]


@pytest.mark.parametrize("value", ["'0.5'", "nan", "inf"])
def test_a_string_is_no_number(complaints, value):
    (complaint,) = complaints(MethodSpec, METHOD, f"algorithm.gamma={value}")
    assert "expected a valid number, found the string" in complaint


def test_there_are_at_least_as_many_samples_as_mini_batches(complaints, read):
    small = METHOD.replace("num_envs: 4", "num_envs: 1, steps_per_env: 3")
    what = "3 samples cannot be split into 4 mini-batches"
    assert complaints(MethodSpec, small) == [f"a.yaml:1:1: algorithm: {what}"]
    read(MethodSpec, small, "algorithm.mini_batches=3")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("algorithm.iterations=0", "expected a number greater than 0, found the number 0"),
        ("algorithm.iterations=1.5", "expected a valid integer, found the number 1.5"),
        (
            "algorithm.num_envs=1048577",
            "expected a number less than or equal to 1048576, found the number 1048577",
        ),
        ("algorithm.learning_rate=-1e-3", "expected a number greater than 0, found the number -0.001"),
        ("algorithm.gamma=1.01", "expected a number less than or equal to 1, found the number 1.01"),
        ("algorithm.gae_lambda=-0.1", "expected a number greater than or equal to 0, found the number -0.1"),
        ("algorithm.clip_value_loss=1", "expected a valid boolean, found the number 1"),
        ("network.initial_std=0", "expected a number greater than 0, found the number 0"),
    ],
)
def test_hyperparameters_are_bounded(complaints, override, message):
    key = override.partition("=")[0]
    assert complaints(MethodSpec, METHOD, override) == [f"--set {override}: {key}: {message}"]


def test_the_bounds_of_the_learning_rate_are_a_range(complaints):
    (complaint,) = complaints(MethodSpec, METHOD, "algorithm.learning_rate_range=[1e-2, 1e-5]")
    assert "algorithm.learning_rate_range: the range [0.01, 1e-05] is reversed" in complaint


def test_an_unknown_activation_names_the_nearest(complaints):
    (complaint,) = complaints(MethodSpec, METHOD, "network.activation=ELU")
    assert complaint.endswith("found the string 'ELU' (did you mean 'elu'?)")


def relaxed(scale: str = "") -> str:
    even = METHOD.replace("[7, 4]", "[8, 4]").replace("[5]", "[4]")
    return even.replace("type: mlp", f"type: relaxed_equivariant{scale}")


def test_a_relaxed_network_has_a_residual_of_some_size(complaints, read):
    network = read(MethodSpec, relaxed(", residual_scale: 0.1")).network
    assert (network.type, network.residual_scale) == ("relaxed_equivariant", 0.1)
    what = "a network of type relaxed_equivariant needs a residual_scale"
    assert complaints(MethodSpec, relaxed()) == [f"a.yaml:2:1: network: {what}"]
    (complaint,) = complaints(MethodSpec, relaxed(", residual_scale: 0.1"), "network.residual_scale=0")
    assert complaint.endswith("network.residual_scale: expected a number greater than 0, found the number 0")
    (complaint,) = complaints(MethodSpec, relaxed(", residual_scale: 0.1"), "network.actor_hidden=[9]")
    assert complaint.endswith("found 9")


def test_other_networks_have_no_residual(complaints):
    (complaint,) = complaints(MethodSpec, METHOD, "network.residual_scale=0.1")
    assert complaint.endswith("residual_scale is for the type relaxed_equivariant; the type is mlp")


def test_the_mirror_loss_is_off_until_it_has_a_weight(complaints, read):
    assert read(MethodSpec, METHOD).symmetry.mirror_loss_coefficient == 0.0
    text = f"{METHOD}symmetry: {{mirror_loss_coefficient: 0.5}}\n"
    assert read(MethodSpec, text).symmetry.mirror_loss_coefficient == 0.5
    (complaint,) = complaints(MethodSpec, text, "symmetry.mirror_loss_coefficient=-1")
    assert complaint.endswith("expected a number greater than or equal to 0, found the number -1")
    (complaint,) = complaints(MethodSpec, text.replace("coefficient", "coeficient"))
    assert "did you mean 'mirror_loss_coefficient'?" in complaint
