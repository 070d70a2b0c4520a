"""ThermoForce: free response of T − F by a frozen forecaster, plus a monotone operator identified on the probe pair."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.interventions.dataset import Window
from thermoforce_mpc.interventions.methods.base import Predictor, Training, best
from thermoforce_mpc.operator.parameters import OperatorParameters
from thermoforce_mpc.protocols import FreeResponse
from thermoforce_mpc.types import Array, Observation
from thermoforce_mpc.world_model import ThermalModel, WorldModel

# Centres of the priors tried: an air-heated zone answers within half an hour to hours, its structure within a day.
_TIME_CONSTANTS_H: dict[int, tuple[tuple[float, ...], ...]] = {
    1: ((2.0,), (6.0,), (20.0,)),
    2: ((0.5, 10.0), (0.7, 30.0), (1.5, 30.0)),
    3: ((0.3, 3.0, 30.0), (0.2, 1.5, 15.0)),
}
# The pairs tell the time constants; the priors only say where to look.
_LOOSE = 1.0


class SuperpositionPredictor:
    """`Predictor` by a thermal model and a free response (paper eq:compose)."""

    def __init__(self, model: ThermalModel, free_response: FreeResponse, note: str) -> None:
        self.model, self.note = model, note
        self._world = WorldModel(model, free_response)

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        outlook = self._world.outlook(Observation(window.history, window.boundary))
        return outlook.predict(u).total_C


def identified(
    training: Training,
    time_constants_h: tuple[float, ...],
    *,
    modulation: Literal["neural", "linear"] = "neural",
    gamma: float = 0.75,
    **options: Any,
) -> ThermalModel:
    """The model of the probe pair with these centres of the priors."""
    settings: dict[str, Any] = {
        "order": len(time_constants_h),
        "time_constants_h": time_constants_h,
        "time_constant_log_sd": _LOOSE,
        "actuator": "identity",
        "modulation": modulation,
        "gamma": gamma,
        "seed": training.seed,
    }
    return identify(
        pairs=[training.probe.pair],
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
) -> SuperpositionPredictor:
    """Identify with each order and each centre of its priors; the best on the validation windows is kept."""
    candidates: Mapping[str, SuperpositionPredictor] = {
        str(taus): SuperpositionPredictor(
            identified(training, taus, modulation=modulation, gamma=gamma), free_response, ""
        )
        for order in orders
        for taus in _TIME_CONSTANTS_H[order]
    }
    chosen = best(candidates, training.validation)
    model = candidates[chosen].model
    return SuperpositionPredictor(model, free_response, describe(model.operator))


def describe(operator: OperatorParameters) -> str:
    """Time constants and gains in one line."""
    hours = ", ".join(f"{tau:.2g} h" for tau in operator.time_constants_h)
    gains = ", ".join(f"{gain:+.1f} K" for gain in operator.steady_gains_K)
    return f"order {operator.order} ({hours}; {gains})"


__all__ = ["Predictor", "SuperpositionPredictor", "build_thermoforce", "describe", "identified"]
