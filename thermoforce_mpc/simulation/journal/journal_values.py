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

from thermoforce_mpc.data import (
    ACTING,
    CONDITIONS,
    SIGNALS,
    Array,
    Block,
    Boundary,
    Measurement,
    Names,
    Period,
    Plan,
    Record,
)

Json = dict[str, Any]

_DTYPES, _MOST_VALUES = ("<f8", "<f4"), 20_000_000

# Arrays of a plan that a journal keeps for people, to four digits or so: a resumed run plans again.
_COURSES = ("u", "T_free_now_C", "T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C")
PLANNED = (*_COURSES, "lower_C", "upper_C", "slack_K", "power_W")


def pack(rows: Array, dtype: str = "<f8") -> Json:
    """An array as JSON."""
    content = zlib.compress(np.ascontiguousarray(rows, dtype=dtype).tobytes(), 6)
    return {"shape": list(rows.shape), "dtype": dtype, "zlib": base64.b64encode(content).decode()}


def unpack(packed: Mapping[str, Any]) -> Array:
    """The array of `pack`; raises `ValueError` for what it did not make."""
    shape, dtype = [int(n) for n in packed["shape"]], str(packed["dtype"])
    if dtype not in _DTYPES or min(shape, default=0) < 0 or not math.prod(shape) <= _MOST_VALUES:
        raise ValueError(f"an array of shape {shape} and type {dtype[:20]}")
    size = math.prod(shape) * np.dtype(dtype).itemsize
    content = zlib.decompressobj().decompress(base64.b64decode(packed["zlib"]), size + 1)
    return np.asarray(np.frombuffer(content, dtype=dtype).reshape(shape), dtype=np.float64)


def number(value: float) -> float | str | None:
    """A number as JSON: null for NaN, 'inf' and '-inf' in words."""
    value = float(value)
    return None if math.isnan(value) else value if math.isfinite(value) else str(value)


def _number(value: float | str | None) -> float:
    return math.nan if value is None else float(value)


def names_json(names: Names) -> Json:
    """Names of zones, actuators and machines."""
    return {"zones": list(names.zones), "actuators": list(names.actuators), "machines": list(names.machines)}


def names_of(content: Mapping[str, Any]) -> Names:
    """The names of `names_json`."""
    return Names(tuple(content["zones"]), tuple(content["actuators"]), tuple(content["machines"]))


def measurement_json(measurement: Measurement) -> Json:
    """A measurement without the plant's own points."""
    content: Json = {name: number(getattr(measurement, name)) for name in ("time_s", "T_out_C", "solar_W_m2")}
    for name in ("T_zone_C", *ACTING):
        content[name] = [number(value) for value in getattr(measurement, name)]
    return content


def measurement_of(content: Mapping[str, Any], names: Names) -> Measurement:
    """The measurement of `measurement_json`."""
    scalars = {name: _number(content[name]) for name in ("time_s", "T_out_C", "solar_W_m2")}
    rows = {name: np.array([_number(value) for value in content[name]]) for name in ("T_zone_C", *ACTING)}
    return Measurement(**scalars, **rows, names=names)  # type: ignore[arg-type]


def record_json(record: Record) -> Json:
    """A record."""
    return {name: pack(getattr(record, name)) for name in SIGNALS}


def record_of(content: Mapping[str, Any], names: Names) -> Record:
    """The record of `record_json`."""
    return Record(**{name: unpack(content[name]) for name in SIGNALS}, names=names)


def boundary_json(boundary: Boundary) -> Json:
    """Boundary conditions, all rows in one packed array."""
    return pack(np.vstack([np.atleast_2d(getattr(boundary, name)) for name in CONDITIONS]))


def boundary_of(packed: Mapping[str, Any], names: Names) -> Boundary:
    """The boundary conditions of `boundary_json`."""
    rows, signals, at = unpack(packed), {}, 0
    for name in CONDITIONS:
        n = 1 if name in ("time_s", "T_out_C", "solar_W_m2") else names.rows(name)
        signals[name] = rows[at] if name in ("time_s", "T_out_C", "solar_W_m2") else rows[at : at + n]
        at += n
    return Boundary(**signals, names=names)


def block_json(block: Block) -> Json:
    """Levels, duration and, where there are any, room set-points."""
    content: Json = {"u": list(block.u), "duration_s": float(block.duration_s)}
    if any(band is not None for band in block.band_C):
        content["band_C"] = [None if band is None else [float(value) for value in band] for band in block.band_C]
    return content


def block_of(content: Mapping[str, Any]) -> Block:
    """The block of `block_json`."""
    bands = [band and (float(band[0]), float(band[1])) for band in content.get("band_C") or ()]
    return Block(content["u"], float(content["duration_s"]), bands or None)


def period_json(period: Period) -> Json:
    """A scored window."""
    return {
        "name": period.name,
        "start_s": float(period.start_s),
        "scored_s": float(period.scored_s),
        "warmup_s": float(period.warmup_s),
    }


def plan_json(plan: Plan, blocks: Sequence[Block], refused: str) -> Json:
    """A decision: who acted and why, what is applied, and the planned course."""
    content: Json = {
        "status": plan.status.value,
        "acting": [status.value for status in plan.acting],
        "why": plan.why,
        "refused": refused,
        "solver_status": plan.solver_status,
        "iterations": int(plan.iterations),
        "export_calls": int(plan.export_calls),
        "blocks": [block_json(block) for block in blocks],
    }
    if plan.news:
        content["news"] = plan.news
    if plan.margins:
        content["margins"] = {name: np.round(values, 4).tolist() for name, values in plan.margins.items()}
    if plan.u.size:
        content["plan"] = {name: pack(getattr(plan, name), "<f4") for name in PLANNED}
    return content


def margins_of(told: Mapping[str, Any]) -> dict[str, Array]:
    """The margins of a decision (`Plan.margins`); empty where nothing was planned, and in journals of before."""
    return {str(name): np.asarray(values, dtype=np.float64) for name, values in dict(told.get("margins", {})).items()}
