"""Conversion of a thermal model to and from JSON values and arrays, the content of its file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.saved.stored_values import built, listed, number, of_fields, text, whole

_OPERATOR_ARRAYS = (
    "poles",
    "gains",
    "hidden_weight",
    "hidden_bias",
    "output_weight",
    "feature_mean",
    "feature_scale",
)
_FREE_ARRAYS = ("poles", "weights", "process_K2", "start_K2")


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
        "power": tuple(built(PowerModel | None, machine["power"]) for machine in machines),
        "free": tuple(_free(zone["free"], arrays, f"zone.{z}.") for z, zone in enumerate(zones)),
        "cards": tuple(built(ModelCard, actuator["card"]) for actuator in actuators),
        "machines": tuple(text(machine["name"]) for machine in machines),
        "machine_of": tuple(whole(actuator["machine"], 0, len(machines) - 1) for actuator in actuators),
        "shares": tuple(number(actuator["share"]) for actuator in actuators),
        "exclusive": tuple(
            tuple(whole(a, 0, len(actuators) - 1) for a in listed(group)) for group in listed(content["exclusive"])
        ),
        "floor_area_m2": tuple(built(float, zone["floor_area_m2"]) for zone in zones),
    }


def _operator(data: Mapping[str, Any], arrays: Mapping[str, Array], prefix: str) -> OperatorParameters:
    return of_fields(OperatorParameters, data, **{name: _array(arrays, prefix + name) for name in _OPERATOR_ARRAYS})


def _array(arrays: Mapping[str, Array], name: str) -> Array:
    array = arrays[name]
    if array.dtype.kind != "f":
        raise TypeError(f"array {name} holds {array.dtype}, expected numbers")
    return array


def _free(data: Mapping[str, Any] | None, arrays: Mapping[str, Array], prefix: str) -> RcParameters | None:
    if data is None:
        return None
    return of_fields(RcParameters, data, **{name: _array(arrays, prefix + name) for name in _FREE_ARRAYS})
