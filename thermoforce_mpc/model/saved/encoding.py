"""Conversion of a thermal model to and from JSON values and arrays, the content of its file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.competence import Competence, HorizonScore
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.foreign_load import HOURS, ForeignLoad
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.machine.return_water import ReturnWater
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.saved.stored_values import keyed, listed, number, number_or_nan, text, truth, whole
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor

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
_COMPETENCE_NUMBERS = ("effect_K", "effect_sd_K", "sign_probability", "log_odds", "held_out_h")
_FREE_ARRAYS = ("poles", "weights", "process_sd_K")


def encode(
    operator: BuildingOperator,
    power: Sequence[PowerModel | None],
    free: Sequence[RcParameters | None],
    cards: Sequence[ModelCard],
    machines: Sequence[str],
    machine_of: Sequence[int],
    shares: Sequence[float],
    exclusive: Sequence[Sequence[int]],
    floor_area_m2: Sequence[float],
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the parts of a thermal model as values of a JSON document, and its arrays by name."""
    arrays: dict[str, Array] = {}
    pairs = []
    for z, a, pair in operator.each():
        arrays |= {f"pair.{z}.{a}.{name}": getattr(pair, name) for name in _OPERATOR_ARRAYS}
        pairs.append({"zone": z, "actuator": a, **_pair_content(pair)})
    zones = []
    for z, (name, linear, area) in enumerate(zip(operator.zones, free, floor_area_m2, strict=True)):
        free_content = None
        if linear is not None:
            arrays |= {f"zone.{z}.{key}": getattr(linear, key) for key in _FREE_ARRAYS}
            free_content = {"step_s": linear.step_s, "sensor_sd_K": linear.sensor_sd_K}
        zones.append({"name": name, "floor_area_m2": area, "free": free_content})
    content = {
        "zones": zones,
        "actuators": [
            {"name": name, "home": home, "machine": machine, "share": share, "card": dataclasses.asdict(card)}
            for name, home, machine, share, card in zip(
                operator.actuators, operator.home, machine_of, shares, cards, strict=True
            )
        ],
        "machines": [
            {"name": name, "power": None if law is None else dataclasses.asdict(law)}
            for name, law in zip(machines, power, strict=True)
        ],
        "exclusive": [list(group) for group in exclusive],
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
    zones, actuators, machines = (listed(content[key]) for key in ("zones", "actuators", "machines"))
    pairs: list[list[OperatorParameters | None]] = [[None] * len(actuators) for _ in zones]
    for pair in listed(content["pairs"]):
        z, a = whole(pair["zone"], 0, len(zones) - 1), whole(pair["actuator"], 0, len(actuators) - 1)
        pairs[z][a] = _operator(pair, arrays, f"pair.{z}.{a}.")
    operator = BuildingOperator(
        tuple(text(zone["name"]) for zone in zones),
        tuple(text(actuator["name"]) for actuator in actuators),
        tuple(tuple(row) for row in pairs),
        tuple(whole(actuator["home"], 0, len(zones) - 1) for actuator in actuators),
    )
    return {
        "operator": operator,
        "power": tuple(_power(machine["power"]) for machine in machines),
        "free": tuple(_free(zone["free"], arrays, f"zone.{z}.") for z, zone in enumerate(zones)),
        "cards": tuple(_card(actuator["card"]) for actuator in actuators),
        "machines": tuple(text(machine["name"]) for machine in machines),
        "machine_of": tuple(whole(actuator["machine"], 0, len(machines) - 1) for actuator in actuators),
        "shares": tuple(number(actuator["share"]) for actuator in actuators),
        "exclusive": tuple(
            tuple(whole(a, 0, len(actuators) - 1) for a in listed(group))
            for group in listed(content.get("exclusive", []))
        ),
        "floor_area_m2": tuple(number_or_nan(zone.get("floor_area_m2")) for zone in zones),
    }


def _operator(data: Mapping[str, Any], arrays: Mapping[str, Array], prefix: str) -> OperatorParameters:
    heat_input = data["heat_input"]
    heat, metered = heat_input["heat"], heat_input.get("metered")
    low, high = heat_input.get("T_out_range_C", (0.0, 0.0))
    return OperatorParameters(
        **{name: _array(arrays, prefix + name) for name in _OPERATOR_ARRAYS},
        output_bias=number(data["output_bias"]),
        gamma=number(data["gamma"]),
        sign=whole(data["sign"], -1, 1),
        step_s=number(data["step_s"]),
        feedback=truth(data["feedback"]),
        heat_input=HeatInput(
            heat=None if heat is None else _load(heat),
            reference_C=number(heat_input["reference_C"]),
            lowest=number(heat_input.get("lowest", 0.0)),
            per_K=number(heat_input.get("per_K", 0.0)),
            T_out_range_C=(number(low), number(high)),
            metered=None if metered is None else _load(metered),
        ),
    )


def _array(arrays: Mapping[str, Array], name: str) -> Array:
    array = arrays[name]
    if array.dtype.kind != "f":
        raise TypeError(f"array {name} holds {array.dtype}, expected numbers")
    return array


def _free(data: Mapping[str, Any] | None, arrays: Mapping[str, Array], prefix: str) -> RcParameters | None:
    if data is None:
        return None
    return RcParameters(
        **{name: _array(arrays, prefix + name) for name in _FREE_ARRAYS},
        step_s=number(data["step_s"]),
        sensor_sd_K=number(data["sensor_sd_K"]),
    )


def _power(data: Mapping[str, Any] | None) -> PowerModel | None:
    if data is None:
        return None
    return PowerModel(
        _load(data["load"]), number_or_nan(data["rmse_W"]), number_or_nan(data["r2"]), text(data["source"]),
        _water(data["water"]), None if data.get("cooling") is None else _load(data["cooling"]),
        _foreign(data.get("foreign")),
    )  # fmt: skip


def _foreign(data: Mapping[str, Any] | None) -> ForeignLoad | None:
    if data is None:
        return None
    low, high = (number(T) for T in data["T_out_range_C"])
    by_hour = tuple(number(W) for W in listed(data["by_hour_W"]))
    if len(by_hour) != HOURS:
        raise ValueError(f"by_hour_W has {len(by_hour)} entries, expected {HOURS}")
    return ForeignLoad(
        by_hour, number(data["per_K_W"]), number(data["reference_C"]), (low, high), number(data["rmse_W"])
    )


def _card(data: Mapping[str, Any]) -> ModelCard:
    return ModelCard(
        source=text(data["source"]),
        data={key: text(value) for key, value in keyed(data["data"]).items()},
        ranges={key: (number_or_nan(low), number_or_nan(high)) for key, (low, high) in keyed(data["ranges"]).items()},
        scores={key: number_or_nan(value) for key, value in keyed(data["scores"]).items()},
        uncertainty={key: number_or_nan(value) for key, value in keyed(data["uncertainty"]).items()},
        config=keyed(data["config"]),
        notes=tuple(text(note) for note in listed(data["notes"])),
        competence=_competence(data["competence"]),
        sun_on_sensor=_sun_on_sensor(data.get("sun_on_sensor")),
    )


def _sun_on_sensor(data: Mapping[str, Any] | None) -> SunOnSensor | None:
    if data is None:
        return None
    return SunOnSensor(**{item.name: number(data[item.name]) for item in dataclasses.fields(SunOnSensor)})


def _competence(data: Mapping[str, Any] | None) -> Competence | None:
    if data is None:
        return None
    return Competence(
        competent=truth(data["competent"]),
        reasons=tuple(text(reason) for reason in listed(data["reasons"])),
        advice=tuple(text(advice) for advice in listed(data["advice"])),
        horizons=tuple(
            HorizonScore(
                blocks=whole(score["blocks"], 0, 10**9),
                **{key: number_or_nan(score.get(key)) for key in _HORIZON_NUMBERS},
            )
            for score in listed(data["horizons"])
        ),
        plainly=text(data.get("plainly", "")),
        **{key: number_or_nan(data.get(key)) for key in _COMPETENCE_NUMBERS},
    )


def _load(data: Mapping[str, Any]) -> MachineLoad:
    c0, c1, c2, c3 = (number(c) for c in data["coefficients"])
    low, high = (number(T) for T in data["T_out_range_C"])
    lowest, levels_seen = number(data["lowest_level"]), truth(data["levels_seen"])
    return MachineLoad((c0, c1, c2, c3), (low, high), lowest, levels_seen, number(data.get("curve_W", 0.0)))


def _water(data: Mapping[str, Any] | None) -> ReturnWater | None:
    if data is None:
        return None
    low, high = (number(T) for T in data["range_C"])
    return ReturnWater(number(data["per_K"]), number(data["reference_C"]), (low, high), number(data["above_zone_K"]))
