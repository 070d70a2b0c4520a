"""ThermoForce: free response of T − F by a frozen forecaster, plus a monotone operator identified on the probe pair."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from thermoforce_mpc.free_response.registry import build_free_response
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.records import Pair
from thermoforce_mpc.interventions.dataset import Window
from thermoforce_mpc.interventions.methods.base import Predictor, Training, best
from thermoforce_mpc.operator.parameters import OperatorParameters
from thermoforce_mpc.protocols import FreeResponse
from thermoforce_mpc.types import Array, History, Observation
from thermoforce_mpc.world_model import ThermalModel, WorldModel

# Centres of the priors tried: an air-heated zone answers within half an hour to hours, its structure within a day.
_TIME_CONSTANTS_H: dict[int, tuple[tuple[float, ...], ...]] = {
    1: ((1.0,), (1.6,), (2.4,), (4.0,), (8.0,), (20.0,)),
    2: ((0.7, 10.0), (1.0, 30.0), (1.5, 30.0)),
    3: ((0.3, 3.0, 30.0), (0.2, 1.5, 15.0)),
}
# One mode cannot have the speed of the room and that of its structure: fitted freely to days it settles between them,
# so its time constant is held near each centre and the validation windows choose. Several modes find their own.
_LOG_SD: dict[int, float] = {1: 0.1, 2: 1.0, 3: 1.0}
# Curvatures of v(u) that are tried where the method has a curve.
CURVES = (0.0, 0.1, 0.2)


def curved(u: Array, curvature: float) -> Array:
    """v(u) = u (1 − β u)/(1 − β), any shape: more heat leaves the room's air the faster; rises with u for β < 1/2.

    Natural convection grows with the temperature difference, so the room answers full power with less than twice what
    it answers half power with. What comes after v is monotone in it, so the whole stays monotone in u.
    """
    return np.asarray(u * (1.0 - curvature * u) / (1.0 - curvature))


def with_curve(history: History, curvature: float) -> History:
    """A record whose control is v(u)."""
    return replace(history, u=curved(history.u, curvature))


class SuperpositionPredictor:
    """`Predictor` by a thermal model and a free response (paper eq:compose); the model's input is v(u)."""

    def __init__(self, model: ThermalModel, free_response: FreeResponse, note: str, curvature: float = 0.0) -> None:
        self.model, self.note, self.curvature = model, note, curvature
        self._world = WorldModel(model, free_response)

    @property
    def modulated(self) -> bool:
        """Whether m(x) was trained and kept; it is 1 otherwise."""
        return bool(self.model.card.scores.get("modulation_kept", 0.0))

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        history = with_curve(window.history, self.curvature)
        outlook = self._world.outlook(Observation(history, window.boundary))
        return outlook.predict(curved(u, self.curvature)).total_C


def identified(
    training: Training,
    time_constants_h: tuple[float, ...],
    *,
    modulation: Literal["neural", "linear"] = "neural",
    gamma: float = 0.75,
    curvature: float = 0.0,
    **options: Any,
) -> ThermalModel:
    """The model of the probe pair with these centres of the priors, driven by v(u) of this curvature."""
    pair = training.probe.pair
    settings: dict[str, Any] = {
        "order": len(time_constants_h),
        "time_constants_h": time_constants_h,
        "time_constant_log_sd": _LOG_SD[len(time_constants_h)],
        "actuator": "identity",
        "modulation": modulation,
        "gamma": gamma,
        "seed": training.seed,
    }
    return identify(
        pairs=[Pair(with_curve(pair.a, curvature), with_curve(pair.b, curvature), label=pair.label)],
        config=IdentificationConfig(**(settings | options)),
        mode=training.climate.spec.mode,
        floor_area_m2=training.climate.spec.floor_area_m2,
        source=f"{training.days} probe days on EnergyPlus {training.climate.name}",
    )


def build_thermoforce(
    training: Training,
    free_response: FreeResponse,
    *,
    orders: tuple[int, ...],
    modulation: Literal["neural", "linear"] = "neural",
    gamma: float = 0.75,
    curvatures: tuple[float, ...] = (0.0,),
    doubt_network: bool = True,
) -> SuperpositionPredictor:
    """Identify with each order, centre of its priors and curvature; the best on the validation windows is kept.

    The choice is made with m = 1, where the effect does not depend on the free response: the cheapest one will do. A
    neural m(x) is then trained at the chosen setting, where asked for, and has to be the better of the two on the
    validation windows, too; without `doubt_network` it is taken as identification gives it.
    """

    def fitted(
        taus: tuple[float, ...], curvature: float, kind: Literal["neural", "linear"], free: FreeResponse
    ) -> SuperpositionPredictor:
        model = identified(training, taus, modulation=kind, gamma=gamma, curvature=curvature)
        return SuperpositionPredictor(model, free, f"{taus}, {curvature:g}, {kind}", curvature)

    settings = {
        f"{taus}, {curvature:g}, linear": (taus, curvature)
        for order in orders
        for taus in _TIME_CONSTANTS_H[order]
        for curvature in curvatures
    }
    cheap = build_free_response("persistence")
    candidates = {name: fitted(*setting, "linear", cheap) for name, setting in settings.items()}
    name = best(candidates, training.validation)
    linear = candidates[name]
    chosen = SuperpositionPredictor(linear.model, free_response, linear.note, linear.curvature)
    if modulation == "neural":
        trained = fitted(*settings[name], "neural", free_response)
        if trained.modulated:
            pair = {"linear": chosen, "neural": trained}
            chosen = pair[best(pair, training.validation)] if doubt_network else trained
    note = describe(chosen.model.operator)
    if modulation == "neural":
        note += ", m(x) trained" if chosen.modulated else ", m(x) = 1"
    if len(curvatures) > 1:
        note += f", curvature {chosen.curvature:g}"
    return SuperpositionPredictor(chosen.model, free_response, note, chosen.curvature)


def describe(operator: OperatorParameters) -> str:
    """Time constants and gains in one line."""
    hours = ", ".join(f"{tau:.2g} h" for tau in operator.time_constants_h)
    gains = ", ".join(f"{gain:+.1f} K" for gain in operator.steady_gains_K)
    return f"order {operator.order} ({hours}; {gains})"


__all__ = ["Predictor", "SuperpositionPredictor", "build_thermoforce", "describe", "identified"]
