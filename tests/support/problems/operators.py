"""Random operators for the tests, from ordinary to adversarial."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.operator.parameters import HIDDEN, OperatorParameters, initial_weight

HEAT_MAP = HeatInput(heat=MachineLoad((1600.0, 20.0, 8500.0, 300.0), (-4.0, 15.0), lowest_level=0.2), reference_C=0.0)


def random_operator(
    seed: int,
    order: int = 1,
    *,
    scale: float = 1.0,
    sign: int = 1,
    gamma: float = 0.75,
    heat_input: HeatInput = IDENTITY,
    step_s: float = 3600.0,
) -> OperatorParameters:
    """An operator with normal weights of size `scale`."""
    rng = np.random.default_rng(seed)
    edges = np.linspace(0.0, 1.0, order + 1)
    bounds = np.stack([edges[:-1], edges[1:]], axis=1)
    poles = rng.uniform(bounds[:, 0] + 0.005, bounds[:, 1] - 0.005)
    gains = rng.uniform(0.01, 1.0, order)
    if order > 1 and rng.random() < 0.7:  # an answer that comes late, up to a pure delay
        weight = initial_weight(poles)
        gains[0] = rng.choice([0.0, 0.1]) - gains[1:] @ weight[1:] / weight[0]
    return OperatorParameters(
        poles=poles,
        gains=sign * gains,
        hidden_weight=rng.normal(size=(HIDDEN, 4)) * scale,
        hidden_bias=rng.normal(size=HIDDEN) * scale,
        output_weight=rng.normal(size=HIDDEN) * scale,
        output_bias=float(rng.normal()) * scale,
        feature_mean=np.array([20.0, 5.0, 100.0, 0.0]),
        feature_scale=np.array([2.0, 5.0, 150.0, 0.7]),
        gamma=gamma,
        sign=sign,
        step_s=step_s,
        heat_input=heat_input,
    )


def random_features(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Features (..., 4) in physical units, of the size a building shows."""
    low, high = np.array([10.0, -10.0, 0.0, -1.0]), np.array([28.0, 20.0, 900.0, 1.0])
    return rng.uniform(low, high, size=(*shape, 4))
