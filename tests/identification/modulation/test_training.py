"""The loss of the training and its gradient, against the operator as a torch module."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record
from later import torch, torch_operator

from thermoforce_mpc.identification import Pair
from thermoforce_mpc.identification.estimation.regression import pair_regression, run_regression
from thermoforce_mpc.identification.estimation.rest import rest_of
from thermoforce_mpc.identification.modulation import Misfit, TrainingData
from thermoforce_mpc.model.free_response.rc import INPUTS, RcParameters
from thermoforce_mpc.model.operator.heat_input import IDENTITY
from thermoforce_mpc.model.operator.parameters import feature_matrix, linear_operator

SD, GAMMA = 0.15, 0.6
FREE = RcParameters(
    np.array([0.93, 0.995]), np.full((2, len(INPUTS)), 1e-3), 900.0, np.diag([0.01, 0.001]), 25.0 * np.eye(2)
)


def by_torch(operator, data):
    """The definition: squares of the whitened residuals of the training rows, and the priors, per row."""
    poles, gains, total, rows = operator.poles.detach(), operator.gains.detach(), 0.0, 0
    for e in data:
        drives = [torch.tensor(s * v) for s, v in e.regression.drives]
        drive = sum(v * operator.modulation(torch.tensor(x)) for v, x in zip(drives, e.features, strict=True))
        forced = [torch.zeros_like(poles)]
        for v in drive:
            forced.append(poles * forced[-1] + gains * v)
        left = torch.tensor(e.regression.target - e.rest.mean) - torch.stack(forced).sum(1)[e.regression.rows]
        whitened = torch.linalg.solve_triangular(torch.tensor(e.rest.factor), left[:, None], upper=False)[:, 0]
        n = e.regression.seen
        total, rows = total + (whitened[:n] ** 2).sum(), rows + n
    weights = (operator.hidden.weight**2).sum() + (operator.hidden.bias**2).sum()
    output = (operator.output.weight**2).sum() * operator.output.in_features + operator.output.bias[0] ** 2
    return (total + weights + output * (GAMMA / SD) ** 2) / rows


def network(operator):
    """The parameters of the network."""
    return [*operator.hidden.parameters(), *operator.output.parameters()]


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("sign", [1, -1])
def test_value_and_gradient_are_those_of_the_definition(order, sign):
    data = []
    for seed, days in ((1, 1.0), (2, 1.25)):
        run = record(House(), days, seed=seed, noise_K=0.01)
        e = run_regression(run, IDENTITY)
        e = replace(e, held=e.rows.size - 70)
        x = feature_matrix(run.T_zone_C[0, :-1], run.T_out_C[:-1], run.solar_W_m2[:-1], run.time_s[:-1])
        data.append(TrainingData(e, (x,), rest_of(e, FREE)))
    for seed, days in ((3, 0.25), (4, 0.25), (5, 0.5)):
        a = record(House(), days, seed=seed)
        pair = Pair(a, record(House(), days, seed=seed, u=np.zeros(a.n_steps)))
        e = pair_regression(pair, IDENTITY)
        x = 5.0 * np.random.default_rng(seed).normal(size=(2, a.n_steps, 4))
        e = replace(e, held=e.rows.size if seed == 4 else 0)  # the second pair is held out
        data.append(TrainingData(e, tuple(x), rest_of(e, FREE)))
    start = linear_operator(
        np.array([0.7, 0.95, 0.995])[:order], sign * np.array([-0.01, 0.05, 0.03])[3 - order :],
        step_s=900.0, sign=sign, gamma=GAMMA, hidden=4, feature_mean=np.array([20.0, 4.0, 60.0, 0.0]),
        feature_scale=np.array([2.0, 4.0, 90.0, 0.7]),
    )  # fmt: skip
    operator = torch_operator.ForcedResponseOperator(start)
    values = torch.nn.utils.parameters_to_vector(network(operator)).detach()
    values += 0.3 * torch.tensor(np.random.default_rng(order).normal(size=values.shape))
    torch.nn.utils.vector_to_parameters(values, network(operator))
    expected = by_torch(operator, data)
    expected.backward()
    gradient = torch.nn.utils.parameters_to_vector([p.grad for p in network(operator)]).numpy()

    misfit = Misfit(start, data, SD)
    assert not misfit.begin.any()
    again = misfit.operator(values.numpy())
    np.testing.assert_allclose(again.modulation(data[0].features[0]), operator.modulation(
        torch.tensor(data[0].features[0])).detach().numpy(), rtol=1e-9)  # fmt: skip
    np.testing.assert_array_equal(again.gains, start.gains)
    value, found = misfit(values.numpy())
    assert value == pytest.approx(float(expected.detach()), rel=1e-10)
    np.testing.assert_allclose(found, gradient, rtol=1e-7, atol=1e-9 * np.abs(gradient).max())
