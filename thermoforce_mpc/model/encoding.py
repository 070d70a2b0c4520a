"""Conversion of a thermal model to and from JSON values and arrays, the content of its file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.competence import Competence, HorizonScore
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.machine.return_water import ReturnWater
from thermoforce_mpc.model.operator.building import BuildingOperator
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
    operator: BuildingOperator,
    power: Sequence[PowerModel | None],
    free: Sequence[RcParameters | None],
    cards: Sequence[ModelCard],
    machines: Sequence[str],
    machine_of: Sequence[int],
    shares: Sequence[float],
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the parts of a thermal model as values of a JSON document, and its arrays by name."""
    arrays: dict[str, Array] = {}
    pairs = []
    for z, a, pair in operator.each():
        arrays |= {f"pair.{z}.{a}.{name}": getattr(pair, name) for name in _OPERATOR_ARRAYS}
        pairs.append({"zone": z, "actuator": a, **_pair_content(pair)})
    zones = []
    for z, (name, linear) in enumerate(zip(operator.zones, free, strict=True)):
        found = None
        if linear is not None:
            arrays |= {f"zone.{z}.{key}": getattr(linear, key) for key in _FREE_ARRAYS}
            found = {"step_s": linear.step_s, "sensor_sd_K": linear.sensor_sd_K}
        zones.append({"name": name, "free": found})
    content = {
        "zones": zones,
        "actuators": [
            {"name": name, "home": home, "machine": machine, "share": share, "card": dataclasses.asdict(card)}
            for name, home, machine, share, card in zip(
                operator.actuators, operator.home, machine_of, shares, cards, strict=True
            )
        ],
        "machines": [
            {"name": name, "power": None if one is None else dataclasses.asdict(one)}
            for name, one in zip(machines, power, strict=True)
        ],
        "n_trained": operator.n_trained,
        "pairs": pairs,
    }
    return content, arrays


def _pair_content(operator: OperatorParameters) -> dict[str, Any]:
    return {
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
    }


def decode(content: Mapping[str, Any], arrays: Mapping[str, Array]) -> dict[str, Any]:
    """Return the parts of a thermal model by the arguments of `encode`, from its values after writing and reading.

    Raises:
        KeyError, TypeError, ValueError, AttributeError, DataError: the content was damaged or edited.
    """
    zones, actuators, machines = content["zones"], content["actuators"], content["machines"]
    pairs: list[list[OperatorParameters | None]] = [[None] * len(actuators) for _ in zones]
    for one in content["pairs"]:
        z, a = int(one["zone"]), int(one["actuator"])
        pairs[z][a] = _operator(one, arrays, f"pair.{z}.{a}.")
    operator = BuildingOperator(
        tuple(str(zone["name"]) for zone in zones),
        tuple(str(actuator["name"]) for actuator in actuators),
        tuple(tuple(row) for row in pairs),
        tuple(int(actuator["home"]) for actuator in actuators),
    )
    return {
        "operator": operator,
        "power": tuple(_power(machine["power"]) for machine in machines),
        "free": tuple(_free(zone["free"], arrays, f"zone.{z}.") for z, zone in enumerate(zones)),
        "cards": tuple(_card(actuator["card"]) for actuator in actuators),
        "machines": tuple(str(machine["name"]) for machine in machines),
        "machine_of": tuple(int(actuator["machine"]) for actuator in actuators),
        "shares": tuple(float(actuator["share"]) for actuator in actuators),
    }


def _operator(data: Mapping[str, Any], arrays: Mapping[str, Array], prefix: str) -> OperatorParameters:
    heat = data["heat_input"]["heat"]
    return OperatorParameters(
        **{name: arrays[prefix + name] for name in _OPERATOR_ARRAYS},
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


def _free(data: Mapping[str, Any] | None, arrays: Mapping[str, Array], prefix: str) -> RcParameters | None:
    if data is None:
        return None
    return RcParameters(
        **{name: arrays[prefix + name] for name in _FREE_ARRAYS},
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
