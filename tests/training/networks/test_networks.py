"""Networks against plain PyTorch: values, gradients, copies, and the scaling around them."""

from __future__ import annotations

import copy
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from cdcsr.robot.description import Robot, load_robot
from cdcsr.tasks.observation import TARGET, TIP_POSITION, observation_size
from training.algorithms.batd3 import BATD3
from training.config.run_config import Learner
from training.experience.replay import Batch
from training.networks.actor_critic import Actor, Critics, Encoder
from training.networks.compiled_ensemble import Ensemble

HIDDEN = (8, 12, 6)
INPUTS, MEMBERS, ROWS = 7, 4, 5


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("paper")


@pytest.fixture(params=[False, True], ids=["plain", "layer_norm"])
def ensemble(request: pytest.FixtureRequest) -> Ensemble:
    torch.manual_seed(0)
    ensemble = Ensemble(INPUTS, HIDDEN, MEMBERS, request.param).double()
    with torch.no_grad():  # so that gains differ from 1 and shifts from 0
        ensemble.rows.add_(0.1 * torch.randn_like(ensemble.rows))
    return ensemble


def reference(ensemble: Ensemble, member: int) -> nn.Sequential:
    """The same network out of PyTorch's own layers."""
    modules: list[nn.Module] = []
    for layer in ensemble.layers(ensemble.rows.detach()[member]):
        linear = nn.Linear(len(layer.weight) - 1, layer.weight.shape[1]).double()
        linear.load_state_dict({"weight": layer.weight[:-1].T, "bias": layer.weight[-1]})
        modules.append(linear)
        if layer.gain is not None and layer.shift is not None:
            norm = nn.LayerNorm(len(layer.gain)).double()
            norm.load_state_dict({"weight": layer.gain, "bias": layer.shift})
            modules.append(norm)
        modules.append(nn.ReLU())
    return nn.Sequential(*modules[:-1])


def rows(count: int = ROWS) -> Tensor:
    return torch.randn(count, INPUTS, dtype=torch.float64)


@pytest.mark.parametrize("members", [None, [2], [3, 0]])
def test_outputs_and_gradients_of_inputs(ensemble: Ensemble, members: list[int] | None) -> None:
    inputs = rows().requires_grad_()
    values = ensemble(inputs, members)
    expected = torch.stack(
        [reference(ensemble, i)(inputs)[:, 0] for i in members or range(MEMBERS)]
    )
    torch.testing.assert_close(values, expected)
    weight = torch.randn_like(values)
    (gradient,) = torch.autograd.grad((values * weight).sum(), inputs)
    (wanted,) = torch.autograd.grad((expected * weight).sum(), inputs)
    torch.testing.assert_close(gradient, wanted)


def test_gradients_of_inputs_by_finite_differences(ensemble: Ensemble) -> None:
    assert torch.autograd.gradcheck(lambda x: ensemble(x, [1, 2]), rows().requires_grad_())


def test_gradients_of_parameters(ensemble: Ensemble) -> None:
    for _ in range(2):  # the second time, over what the first left behind
        inputs, target = rows(), torch.randn(ROWS, dtype=torch.float64)
        values = ensemble.regress(inputs, target)
        assert ensemble.rows.grad is not None
        for i in range(MEMBERS):
            network = reference(ensemble, i)
            output = network(inputs)[:, 0]
            nn.functional.mse_loss(output, target).backward()
            torch.testing.assert_close(values[i], output.detach())
            got = ensemble.layers(ensemble.rows.grad[i])
            linears = [module for module in network if isinstance(module, nn.Linear)]
            norms = [module for module in network if isinstance(module, nn.LayerNorm)]
            for layer, linear in zip(got, linears, strict=True):
                assert linear.weight.grad is not None
                assert linear.bias.grad is not None
                torch.testing.assert_close(
                    layer.weight, torch.vstack([linear.weight.grad.T, linear.bias.grad])
                )
            for layer, norm in zip(got, norms, strict=False):
                torch.testing.assert_close(layer.gain, norm.weight.grad)
                torch.testing.assert_close(layer.shift, norm.bias.grad)


def test_a_hidden_layer_of_one_unit() -> None:
    ensemble = Ensemble(INPUTS, (4, 1), 1, layer_norm=False).double()
    inputs = rows()
    torch.testing.assert_close(
        ensemble.regress(inputs, torch.zeros(ROWS).double())[0],
        reference(ensemble, 0)(inputs)[:, 0],
    )


def test_padding_never_learns() -> None:
    ensemble = Ensemble(INPUTS, HIDDEN, MEMBERS, layer_norm=True)
    used = sum((n + 1) * m for n, m in pairwise(ensemble.widths)) + 2 * sum(HIDDEN)
    optimizer = torch.optim.Adam(ensemble.parameters(), fused=True)
    ensemble.regress(rows().float(), torch.ones(ROWS))
    optimizer.step()
    assert used < ensemble.rows.shape[1]
    assert not ensemble.rows[:, used:].any()
    assert ensemble.rows[:, used - 1].all()


def test_graphs_alive_at_once_do_not_disturb_each_other(ensemble: Ensemble) -> None:
    first, second = rows().requires_grad_(), rows().requires_grad_()
    (alone,) = torch.autograd.grad(ensemble(first).square().sum(), first)
    a, b = ensemble(first), ensemble(second)
    ensemble.regress(rows(), torch.zeros(ROWS, dtype=torch.float64))
    together, _ = torch.autograd.grad(a.square().sum() + b.sum(), [first, second])
    assert torch.equal(together, alone)


def test_parameters_have_no_gradient_through_outputs(ensemble: Ensemble) -> None:
    assert not ensemble(rows()).requires_grad


def test_batches_of_different_size_and_type(ensemble: Ensemble) -> None:
    inputs = rows(9)
    whole = ensemble(inputs)
    torch.testing.assert_close(ensemble(inputs[:4]), whole[:, :4])
    with pytest.raises(RuntimeError, match="shapes"):
        ensemble(inputs[:, :1])
    single = ensemble.float()(inputs.float())
    torch.testing.assert_close(single, whole.float(), rtol=1e-4, atol=1e-5)


def test_copies_and_loaded_weights_are_used(ensemble: Ensemble) -> None:
    inputs, target = rows(), torch.zeros(ROWS, dtype=torch.float64)
    before = ensemble.regress(inputs, target)
    twin = copy.deepcopy(ensemble).requires_grad_(False)
    with torch.no_grad():
        ensemble.rows.mul_(2)
    changed = ensemble(inputs)
    assert torch.equal(twin(inputs), before)
    assert not torch.equal(changed, before)
    twin.load_state_dict(ensemble.state_dict())
    assert torch.equal(twin(inputs), changed)
    twin.rows.data = twin.rows.data * 0  # moved elsewhere
    assert not twin(inputs).any()


def test_initialized_as_linear_layers() -> None:
    torch.manual_seed(3)
    ensemble = Ensemble(INPUTS, HIDDEN, 2, layer_norm=False)
    torch.manual_seed(3)
    for member in ensemble.rows:
        for layer in ensemble.layers(member):
            linear = nn.Linear(len(layer.weight) - 1, layer.weight.shape[1])
            assert torch.equal(layer.weight[:-1], linear.weight.T)
            assert torch.equal(layer.weight[-1], linear.bias)


def test_critics_take_state_and_action(robot: Robot) -> None:
    critics = Critics(INPUTS + robot.num_cables, HIDDEN, MEMBERS, layer_norm=True)
    encoded, action = rows().float(), torch.rand(ROWS, robot.num_cables, requires_grad=True)
    values = critics(encoded, action, [1, 3])
    assert values.shape == (2, ROWS)
    values.sum().backward()
    assert action.grad is not None
    assert torch.equal(
        critics.regress(encoded, action.detach(), torch.zeros(ROWS))[[1, 3]], values.detach()
    )


# -- a whole update -----------------------------------------------------------------------------------------------


def batch(robot: Robot, count: int = 16) -> Batch:
    size, cables = observation_size(robot), robot.num_cables
    return Batch(
        torch.randn(count, size),
        torch.rand(count, cables) * 2 - 1,
        torch.rand(count),
        torch.full((count,), 0.9),
        torch.randn(count, size),
        torch.rand(count, cables) * 2 - 1,
        torch.rand(count, cables) * 2 - 1,
        torch.rand(count),
    )


def learned(robot: Robot, learner: Learner) -> BATD3:
    torch.manual_seed(0)
    algorithm = BATD3(robot, learner, torch.Generator().manual_seed(1))
    for _ in range(4):
        algorithm.update(batch(robot))
    return algorithm


@pytest.mark.parametrize("layer_norm", [False, True])
def test_same_seed_same_weights(robot: Robot, layer_norm: bool) -> None:
    learner = Learner(hidden=(32, 32), layer_norm=layer_norm, features="state+error")
    first, second = learned(robot, learner), learned(robot, learner)
    for a, b in ((first.critics, second.critics), (first.actor, second.actor)):
        for name, value in a.state_dict().items():
            assert torch.equal(value, b.state_dict()[name]), name


def test_targets_follow(robot: Robot) -> None:
    algorithm = learned(robot, Learner(hidden=(16,), soft_update=0.25))
    before = algorithm.target_critics.ensemble.rows.clone()
    algorithm.update(batch(robot))
    expected = 0.75 * before + 0.25 * algorithm.critics.ensemble.rows.detach()
    torch.testing.assert_close(algorithm.target_critics.ensemble.rows, expected)
    assert not algorithm.target_critics.ensemble.rows.requires_grad


# -- scaling ------------------------------------------------------------------------------------------------------


def test_commands_span_the_servos_travel(robot: Robot) -> None:
    actor = Actor(robot, False, (4,), "tanh")
    eta = torch.tensor([servo.eta for servo in robot.servos], dtype=torch.float32)
    ones = torch.ones(robot.num_cables)
    torch.testing.assert_close(actor.to_command(-ones), -eta)
    torch.testing.assert_close(actor.to_command(ones), 0 * eta)
    action = torch.rand(6, robot.num_cables) * 2 - 1
    torch.testing.assert_close(actor.from_command(actor.to_command(action)), action)


def test_encoder(robot: Robot) -> None:
    """Tip 15 cm above the workspace's centre (0.15 / 0.3 = 0.5), target 6 cm to its side (0.06 / 0.3 = 0.2)."""
    observation = np.zeros(observation_size(robot))
    observation[TIP_POSITION] = np.add(robot.workspace.center, (0, 0, 0.15))
    observation[TARGET] = np.add(robot.workspace.center, (0.06, 0, 0))
    observation[13] = 1  # the base's quaternion, upright
    observation[-1] = -0.03  # the last cable's travel
    encoded = Encoder(robot, with_error=True)(torch.as_tensor(observation, dtype=torch.float32))
    size = observation_size(robot)
    expected = torch.zeros(size + 3)
    expected[2], expected[6], expected[size - 1] = 0.5, 0.2, -1
    expected[size:] = torch.tensor([0.6, 0, -1.5])  # from tip to target, in decimetres
    torch.testing.assert_close(encoded, expected)
    plain = Encoder(robot, with_error=False)(torch.as_tensor(observation, dtype=torch.float32))
    torch.testing.assert_close(plain, expected[:size])
