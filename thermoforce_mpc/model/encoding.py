"""Conversion of a thermal model to and from JSON values and arrays, the content of its file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.competence import Competence, HorizonScore
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.machine.return_water import ReturnWater
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters

_OPERATOR_ARRAYS = (
    "poles",
    "gains",
    "hidden_weight",
    "hidden_bias",
    "output_weight",
    "feature_mean",
    "feature_scale",
    "pole_bounds",
)
_HORIZON_NUMBERS = ("hours", "model_K", "persistence_K", "weather_K", "better_t", "persistence_t")
_COMPETENCE_NUMBERS = ("effect_K", "effect_sd_K", "sign_probability", "explained", "held_out_h")
_FREE_ARRAYS = ("poles", "weights", "process_sd_K")


def encode(
    operator: OperatorParameters, power: PowerModel | None, free: RcParameters | None, card: ModelCard
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the parts of a thermal model as values of a JSON document, and its arrays by name."""
    arrays = {f"operator.{name}": getattr(operator, name) for name in _OPERATOR_ARRAYS}
    if free is not None:
        arrays |= {f"free.{name}": getattr(free, name) for name in _FREE_ARRAYS}
    content = {
        "operator": {
            "order": operator.order,
            "n_trained": operator.n_trained,
            "output_bias": operator.output_bias,
            "gamma": operator.gamma,
            "sign": operator.sign,
            "step_s": operator.step_s,
            "feedback": operator.feedback,
            "heat_input": dataclasses.asdict(operator.heat_input),
            "time_constants_h": operator.time_constants_h,
            "steady_gains_K": operator.steady_gains_K,
        },
        "free": None if free is None else {"step_s": free.step_s, "sensor_sd_K": free.sensor_sd_K},
        "power": None if power is None else dataclasses.asdict(power),
        "card": dataclasses.asdict(card),
    }
    return content, arrays


def decode(
    content: Mapping[str, Any], arrays: Mapping[str, Array]
) -> tuple[OperatorParameters, PowerModel | None, RcParameters | None, ModelCard]:
    """Return the parts of a thermal model from the values and arrays of `encode`, after writing and reading.

    Raises:
        KeyError, TypeError, ValueError, AttributeError, DataError: the content was damaged or edited.
    """
    return (
        _operator(content["operator"], arrays),
        _power(content["power"]),
        _free(content["free"], arrays),
        _card(content["card"]),
    )


def _operator(data: Mapping[str, Any], arrays: Mapping[str, Array]) -> OperatorParameters:
    heat = data["heat_input"]["heat"]
    return OperatorParameters(
        **{name: arrays[f"operator.{name}"] for name in _OPERATOR_ARRAYS},
        output_bias=float(data["output_bias"]),
        gamma=float(data["gamma"]),
        sign=int(data["sign"]),
        step_s=float(data["step_s"]),
        feedback=data["feedback"],
        heat_input=HeatInput(
            heat=None if heat is None else _load(heat),
            reference_C=float(data["heat_input"]["reference_C"]),
            lowest=float(data["heat_input"].get("lowest", 0.0)),
        ),
    )


def _free(data: Mapping[str, Any] | None, arrays: Mapping[str, Array]) -> RcParameters | None:
    if data is None:
        return None
    return RcParameters(
        **{name: arrays[f"free.{name}"] for name in _FREE_ARRAYS},
        step_s=float(data["step_s"]),
        sensor_sd_K=float(data["sensor_sd_K"]),
    )


def _power(data: Mapping[str, Any] | None) -> PowerModel | None:
    if data is None:
        return None
    return PowerModel(
        _load(data["load"]), _number(data["rmse_W"]), _number(data["r2"]), str(data["source"]), _water(data["water"]),
        None if data.get("cooling") is None else _load(data["cooling"]),
    )  # fmt: skip


def _card(data: Mapping[str, Any]) -> ModelCard:
    return ModelCard(
        source=data["source"],
        data=data["data"],
        ranges={key: (_number(low), _number(high)) for key, (low, high) in data["ranges"].items()},
        scores={key: _number(value) for key, value in data["scores"].items()},
        uncertainty={key: _number(value) for key, value in data["uncertainty"].items()},
        config=data["config"],
        notes=tuple(data["notes"]),
        competence=_competence(data.get("competence")),  # files before the verdict was introduced do not have it
    )


def _competence(data: Mapping[str, Any] | None) -> Competence | None:
    if data is None:
        return None
    return Competence(
        competent=bool(data["competent"]),
        reasons=tuple(data["reasons"]),
        advice=tuple(data["advice"]),
        horizons=tuple(
            HorizonScore(blocks=int(one["blocks"]), **{key: _number(one.get(key)) for key in _HORIZON_NUMBERS})
            for one in data["horizons"]
        ),
        **{key: _number(data[key]) for key in _COMPETENCE_NUMBERS},
    )


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _load(data: Mapping[str, Any]) -> MachineLoad:
    c0, c1, c2, c3 = (float(c) for c in data["coefficients"])
    low, high = (float(T) for T in data["T_out_range_C"])
    return MachineLoad((c0, c1, c2, c3), (low, high), float(data["lowest_level"]), bool(data["levels_seen"]))


def _water(data: Mapping[str, Any] | None) -> ReturnWater | None:
    if data is None:
        return None
    low, high = (float(T) for T in data["range_C"])
    return ReturnWater(float(data["per_K"]), float(data["reference_C"]), (low, high), float(data["above_zone_K"]))
