"""ThermoForce: free response of T − F by a frozen forecaster, plus a monotone operator identified on the probe pair."""

from __future__ import annotations

from itertools import product
from typing import Any, Literal

import numpy as np

from benchmarks.interventions.dataset import Window
from benchmarks.interventions.methods.base import Training, best, clearly_better
from benchmarks.interventions.methods.curve import curved, with_curve
from thermoforce_mpc.data import Array, Observation
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.model.operator.building import forced_rollout
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OperatorParameters
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse

Modulation = Literal["always", "auto", "linear"]


class SuperpositionPredictor:
    """`Predictor`: thermal model plus free response (paper eq:compose); the input of the model is v(u)."""

    def __init__(self, model: ThermalModel, free_response: FreeResponse, note: str, exponent: float = 1.0) -> None:
        self.model, self.note, self.exponent = model, note, exponent
        self._predictor = Predictor(model.operator, free_response)

    @property
    def modulated(self) -> bool:
        """Whether m(x) was trained and kept; otherwise m = 1."""
        return bool(self.model.only.card.scores.get("modulation_kept", 0.0))

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        history = with_curve(window.history, self.exponent)
        context = self._predictor.context(Observation(history, window.boundary))
        return context.predict(curved(u, self.exponent)[:, None]).total_C[:, 0]


class LinearEffect:
    """`Predictor` of effects for the choice of settings: with m = 1 they do not depend on history or free response.

    It returns the forced response from rest, K, so only differences of its predictions are meaningful.
    """

    def __init__(self, model: ThermalModel, note: str, exponent: float) -> None:
        self.model, self.note, self.exponent = model, note, exponent

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`; here without the free response, which is the same for all plans."""
        operator = self.model.only.operator.resampled(window.boundary.step_s)
        features = np.zeros((u.shape[1], N_FEATURES))
        rest = np.zeros(operator.order)
        return np.asarray(forced_rollout(operator, rest, curved(u, self.exponent), features).sum(axis=-1))


def identified(
    training: Training,
    order: int,
    *,
    modulation: Modulation = "auto",
    gamma: float = 0.75,
    exponent: float = 1.0,
) -> ThermalModel:
    """Identify so many modes from the probe pair, with input v(u) of the given exponent."""
    pair = training.probe.pair
    settings: dict[str, Any] = {
        "order": order,
        "heat_input": "identity",
        "modulation": modulation,
        "gamma": gamma,
        "seed": training.seed,
    }
    return identify(
        pairs=[Pair(with_curve(pair.a, exponent), with_curve(pair.b, exponent), label=pair.label)],
        config=IdentificationConfig(**settings),
        mode=training.climate.spec.mode,
        floor_area_m2=training.climate.spec.floor_area_m2,
        source=f"{training.days} probe days on EnergyPlus {training.climate.name}",
    )


def build_thermoforce(
    training: Training,
    free_response: FreeResponse,
    *,
    orders: tuple[int, ...],
    modulation: Modulation = "auto",
    gamma: float = 0.75,
    exponents: tuple[float, ...] = (1.0,),
    doubt_network: bool = True,
) -> SuperpositionPredictor:
    """Identify with each order and exponent, and keep the best on the validation windows.

    The choice is made with m = 1. If requested, a neural m(x) is then trained at the chosen setting. By `auto` it is
    kept only if it is also clearly better on the validation windows; without `doubt_network` this check is skipped.
    """
    candidates = {}
    settings = {}
    for order, exponent in product(orders, exponents):
        name = f"order {order}, exponent {exponent:g}"
        model = identified(training, order, modulation="linear", gamma=gamma, exponent=exponent)
        candidates[name], settings[name] = LinearEffect(model, name, exponent), order
    name = best(candidates, training.validation)
    linear, exponent = candidates[name], candidates[name].exponent
    model = linear.model
    if modulation != "linear":
        trained = identified(training, settings[name], modulation=modulation, gamma=gamma, exponent=exponent)
        network = SuperpositionPredictor(trained, free_response, name, exponent)
        believed = modulation == "always" or not doubt_network
        if network.modulated and (believed or clearly_better(network, linear, training.validation)):
            model = trained
    chosen = SuperpositionPredictor(model, free_response, "", exponent)
    chosen.note = describe(model.only.operator)
    if modulation != "linear":
        chosen.note += ", m(x) trained" if chosen.modulated else ", m(x) = 1"
    if len(exponents) > 1:
        chosen.note += f", exponent {exponent:g}"
    return chosen


def describe(operator: OperatorParameters) -> str:
    """Time constants and gains in one line."""
    hours = ", ".join(f"{tau:.2g} h" for tau in operator.time_constants_h)
    gains = ", ".join(f"{gain:+.1f} K" for gain in operator.steady_gains_K)
    return f"order {operator.order} ({hours}; {gains})"
