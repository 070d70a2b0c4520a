"""What travels between plant and controller, as JSON of a journal: exact, with null where there is no number.

Long arrays are packed: float64 by rows, zlib, base64.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from boptest_client import safe_text
from thermoforce_mpc.data import ACTING, CONDITIONS, SIGNALS, Array, Block, Boundary, Measurement, Names, Plan, Record

Json = dict[str, Any]

_MOST_VALUES = 20_000_000

# Arrays of a plan that a journal keeps for people, and to what they are rounded: a resumed run plans again.
_KELVIN = ("T_free_now_C", "T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C", "lower_C", "upper_C", "slack_K")
_ROUNDED = {"u": 0.001, **dict.fromkeys(_KELVIN, 0.01), "power_W": 1.0}
_NOTHING = -(2**31)
_READINGS = ("T_out_C", "solar_W_m2", "T_zone_C", *ACTING)


def _deflated(content: bytes, effort: int) -> str:
    return base64.b64encode(zlib.compress(content, effort)).decode()


def _inflated(text: str, shapes: Sequence[Sequence[int]], each: int) -> bytes:
    """The bytes of arrays of `shapes`, `each` a value; raises `ValueError` for more than any record holds."""
    size = sum(math.prod(shape) for shape in shapes)
    if not size <= _MOST_VALUES or any(n < 0 for shape in shapes for n in shape):
        raise ValueError(f"arrays of shapes {shapes}")
    return zlib.decompressobj().decompress(base64.b64decode(text), each * size + 1)


def pack(rows: Array) -> Json:
    """An array as JSON."""
    content = np.ascontiguousarray(rows, dtype="<f8").tobytes()
    return {"shape": list(rows.shape), "zlib": _deflated(content, 6)}


def unpack(packed: Mapping[str, Any]) -> Array:
    """The array of `pack`; raises `ValueError` for what it did not make."""
    shape = [int(n) for n in packed["shape"]]
    content = _inflated(packed["zlib"], [shape], 8)
    return np.asarray(np.frombuffer(content, dtype="<f8").reshape(shape), dtype=np.float64)


def number(value: float) -> float | str | None:
    """A number as JSON: null for NaN, 'inf' and '-inf' in words."""
    value = float(value)
    return None if math.isnan(value) else value if math.isfinite(value) else str(value)


def kpis_json(kpis: Mapping[str, float]) -> Json:
    """KPIs by name."""
    return {name: number(value) for name, value in kpis.items()}


def kpis_of(content: Mapping[str, Any]) -> dict[str, float]:
    """The KPIs of `kpis_json`."""
    return {name: math.nan if value is None else float(value) for name, value in content.items()}


def names_of(content: Mapping[str, Any]) -> Names:
    """The names (`Names`), as a terminal may show them."""
    zones, actuators, machines = (tuple(map(safe_text, content[key])) for key in ("zones", "actuators", "machines"))
    return Names(zones, actuators, machines)


def measurement_json(measurement: Measurement) -> Json:
    """A measurement without the plant's own points: its time, and its values as float64 in base64."""
    rows = [np.atleast_1d(getattr(measurement, name)) for name in _READINGS]
    values = np.concatenate(rows).astype("<f8").tobytes()
    return {"time_s": number(measurement.time_s), "values": base64.b64encode(values).decode()}


def measurement_of(content: Mapping[str, Any], names: Names) -> Measurement:
    """The measurement of `measurement_json`; raises `ValueError` where it is of other `names`."""
    values = np.frombuffer(base64.b64decode(content["values"]), "<f8")
    sizes = [1, 1, *(names.rows(name) for name in _READINGS[2:])]
    if values.size != sum(sizes):
        raise ValueError(f"{values.size} readings where there are {sum(sizes)}")
    signals: dict[str, Any] = dict(zip(_READINGS, np.split(values, np.cumsum(sizes)[:-1]), strict=True))
    signals |= {name: float(signals[name][0]) for name in _READINGS[:2]}
    return Measurement(float(content["time_s"]), names=names, **signals)


def record_json(record: Record) -> Json:
    """A record."""
    return {name: pack(getattr(record, name)) for name in SIGNALS}


def record_of(content: Mapping[str, Any], names: Names) -> Record:
    """The record of `record_json`."""
    return Record(**{name: unpack(content[name]) for name in SIGNALS}, names=names)


def boundary_rows(boundary: Boundary) -> Array:
    """Boundary conditions, all rows in one array (rows, N + 1)."""
    return np.vstack([np.atleast_2d(getattr(boundary, name)) for name in CONDITIONS])


def boundary_of(rows: Array, names: Names) -> Boundary:
    """The boundary conditions of `boundary_rows`."""
    signals: dict[str, Any] = {}
    at = 0
    for name in CONDITIONS:
        single = name in ("time_s", "T_out_C", "solar_W_m2")
        n = 1 if single else names.rows(name)
        signals[name], at = rows[at] if single else rows[at : at + n], at + n
    return Boundary(**signals, names=names)


def rows_json(rows: Array, before: Array | None) -> Json:
    """A forecast (`boundary_rows`): how many columns are those of the one `before` from which on, and the others."""
    at = n = 0
    if before is not None:
        at = int(np.searchsorted(before[0], rows[0, 0]))
        n = min(before.shape[1] - at, rows.shape[1])
        if not np.array_equal(before[:, at : at + n], rows[:, :n], equal_nan=True):
            at = n = 0
    return {"from": at, "same": n, "new": pack(rows[:, n:])}


def repeated_rows(content: Mapping[str, Any], before: Array | None) -> Array:
    """The rows of `rows_json`; raises `ValueError` where `before` is not what it was then."""
    new, at, n = unpack(content["new"]), int(content["from"]), int(content["same"])
    if not n:
        return new
    if before is None or not 0 <= at <= at + n <= before.shape[1]:
        there = 0 if before is None else before.shape[1]
        raise ValueError(f"a forecast that repeats {n} columns from {at} on of one of {there}")
    return np.hstack([before[:, at : at + n], new])


def block_json(block: Block) -> Json:
    """Levels, duration and, where there are any, commands: numbers, or room set-points as pairs."""
    content: Json = {"u": list(block.u), "duration_s": float(block.duration_s)}
    if any(command is not None for command in block.command):
        content["command"] = [
            [float(value) for value in command] if isinstance(command, tuple) else command for command in block.command
        ]
    return content


def block_of(content: Mapping[str, Any]) -> Block:
    """The block of `block_json`."""
    commands = [
        tuple(map(float, command)) if isinstance(command, list) else command for command in content.get("command") or ()
    ]
    return Block(content["u"], float(content["duration_s"]), commands or None)


def plan_json(plan: Plan, blocks: Sequence[Block], refused: str) -> Json:
    """A decision: who acted and why, what is applied, and the planned course."""
    content: Json = {
        "status": plan.status.value,
        "acting": [status.value for status in plan.acting],
        "why": plan.why,
        "refused": refused,
        "solver_status": plan.solver_status,
        "iterations": int(plan.iterations),
        "variables": int(plan.variables),
        "parameters": int(plan.parameters),
        "blocks": [block_json(block) for block in blocks],
    }
    if plan.news:
        content["news"] = plan.news
    if plan.margins:
        content["margins"] = {name: np.round(values, 4).tolist() for name, values in plan.margins.items()}
    if plan.u.size:
        content["plan"] = _planned_json(plan)
    return content


def _planned_json(plan: Plan) -> Json:
    """The planned courses, rounded: changes from value to value of all of them, their four bytes apart, in zlib."""
    courses = [np.asarray(getattr(plan, name)) for name in _ROUNDED]
    values = np.concatenate([course.ravel() / unit for course, unit in zip(courses, _ROUNDED.values(), strict=True)])
    codes = np.where(np.abs(values) < -_NOTHING, np.rint(values), _NOTHING).astype(np.int32)
    change = np.diff(codes, prepend=np.int32(0))
    # Each row begins with its value itself.
    lengths = [n for course in courses for n in [course.shape[-1]] * (course.size // max(course.shape[-1], 1))]
    begins = np.cumsum([0, *lengths[:-1]])
    change[begins] = codes[begins]
    shapes = [list(course.shape) for course in courses]
    # Small changes of either sign become small numbers without one.
    octets = ((change << 1) ^ (change >> 31)).astype("<u4").view(np.uint8).reshape(-1, 4).T
    return {"shapes": shapes, "zlib": _deflated(octets.tobytes(), 9)}


def planned_of(told: Mapping[str, Any]) -> dict[str, Array]:
    """The planned courses of a decision by name, NaN where there is no number; empty where nothing was planned."""
    if "plan" not in told:
        return {}
    shapes = [[int(n) for n in shape] for shape in told["plan"]["shapes"]]
    octets = np.frombuffer(_inflated(told["plan"]["zlib"], shapes, 4), np.uint8).reshape(4, -1)
    z = np.ascontiguousarray(octets.T).view("<u4").ravel().astype(np.uint32)
    change = (z >> 1).astype(np.int32) ^ -(z & 1).astype(np.int32)
    courses, at = {}, 0
    for name, shape in zip(_ROUNDED, shapes, strict=True):
        n = math.prod(shape)
        codes = np.cumsum(change[at : at + n].reshape(shape), axis=-1, dtype=np.int32)
        courses[name] = np.where(codes == _NOTHING, np.nan, codes * _ROUNDED[name])
        at += n
    return courses


def margins_of(told: Mapping[str, Any]) -> dict[str, Array]:
    """The margins of a decision (`Plan.margins`); empty where nothing was planned."""
    return {str(name): np.asarray(values, dtype=np.float64) for name, values in dict(told.get("margins", {})).items()}
