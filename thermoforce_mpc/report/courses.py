"""What was measured in a run, and what it had cost by then, as arrays of the page."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, J_PER_KWH, Array, Layout
from thermoforce_mpc.loop.closed_loop import RunResult, Sample, StepRecord, in_force
from thermoforce_mpc.loop.forecasts import price_paid
from thermoforce_mpc.plants.kpis import excess
from thermoforce_mpc.report.page import Json, exactly, packed, rows_packed

# Bytes of the courses of all runs of a page, before base64 adds a third; of more, consecutive blocks are averaged.
MOST_BYTES = 800_000
# Coarsest roundings: K, W, level, W/m², price and cost per kWh and m².
RESOLUTION = {"T": 0.002, "W": 5.0, "u": 1e-4, "sun": 0.1, "price": 1e-4, "cost": 1e-4, "Kh": 0.002}
# Of each sample as it is.
_SAMPLED = (
    "start_s", "duration_s", "T_out_C", "solar_W_m2", "T_zone_C", "lower_C", "upper_C", "power_W", "price_per_kWh",
)  # fmt: skip


@dataclass(frozen=True)
class RunCourse:
    """All n blocks of a run, or means over several consecutive ones.

    `start_s`, `duration_s`, `T_out_C`, `solar_W_m2` (n,); `T_zone_C`, `lower_C`, `upper_C` (Z, n), `u` (A, n) and
    `power_W`, `price_per_kWh` (M, n) as in `Sample`. `cost` (n,) per m² and `discomfort_Kh` (Z, n) are those until the
    end of each block. `band_C` (2, A, n): heating and cooling set-point given to the plant's own loops, °C, NaN where
    levels were. `averaged`: number of blocks taken together. `scaled`: what the cost by the meters was multiplied by so
    that it ends at the plant's own bill, where a machine is billed in two carriers; else 1.
    """

    start_s: Array
    duration_s: Array
    T_out_C: Array
    solar_W_m2: Array
    T_zone_C: Array
    lower_C: Array
    upper_C: Array
    u: Array
    power_W: Array
    price_per_kWh: Array
    cost: Array
    discomfort_Kh: Array
    band_C: Array
    averaged: int
    scaled: float = 1.0

    def to_json(self) -> Json:
        """All of it, packed."""
        of = RESOLUTION
        return {
            "T_out_C": packed(self.T_out_C, of["T"]),
            "solar_W_m2": packed(self.solar_W_m2, of["sun"]),
            "lower_C": rows_packed(self.lower_C, of["T"]),
            "upper_C": rows_packed(self.upper_C, of["T"]),
            "price_per_kWh": rows_packed(self.price_per_kWh, of["price"]),
            "band_C": None if np.isnan(self.band_C).all() else [rows_packed(side, of["T"]) for side in self.band_C],
            **self.own_json(),
        }

    def own_json(self) -> Json:
        """What differs from one controller to the next."""
        of = RESOLUTION
        return {
            "start_s": exactly(self.start_s),
            "duration_s": exactly(self.duration_s),
            "T_zone_C": rows_packed(self.T_zone_C, of["T"]),
            "u": rows_packed(self.u, of["u"]),
            "power_W": rows_packed(self.power_W, of["W"]),
            "cost": packed(self.cost, of["cost"]),
            "discomfort_Kh": rows_packed(self.discomfort_Kh, of["Kh"]),
        }


def most_blocks(layout: Layout, runs: int) -> int:
    """How many blocks of each of `runs` runs a page has room for."""
    Z, A, M = len(layout.names.zones), len(layout.names.actuators), len(layout.names.machines)
    shared = 2 + 2 * Z + 2 * A + M
    own = 2 * Z + A + M + 1
    return MOST_BYTES // (2 * (shared + runs * own) + 16 * runs)


def course_of(result: RunResult, layout: Layout, area_m2: float, most: int) -> RunCourse:
    """The course of a run, of at most `most` blocks.

    Cost is that of the mean power of each block at the price in force, discomfort that of straight lines between the
    temperatures at the ends of blocks: both are near to the KPIs, which are of samples every 30 s. Where a machine's
    heating has a price of its own, its meter adds gas and the fan's electricity: the cost is then scaled to the KPI.
    """
    samples: list[Sample] = []
    heating_price: list[Array] = []
    bands: list[Array] = []
    for step in result.steps:
        for k, sample in enumerate(step.samples):
            samples.append(sample)
            heating = step.boundary.heating_price_per_kWh
            heating_price.append(heating[:, in_force(step.boundary, sample.start_s)].copy())  # not the whole forecast
            bands.append(_band_C(step, k))
    columns = {name: np.array([getattr(s, name) for s in samples], dtype=np.float64).T for name in _SAMPLED}
    columns["u"] = np.array([sample.u_measured for sample in samples], dtype=np.float64).T
    price = price_paid(columns["u"], columns["price_per_kWh"], np.array(heating_price).T, layout)
    # A machine that is not metered counts for nothing, and does not hide the others.
    paid = columns["power_W"] * price
    spent = np.where(np.isfinite(paid), paid, 0.0).sum(axis=0) * columns["duration_s"] / J_PER_KWH / area_m2
    before_C = np.column_stack([result.start.T_zone_C, columns["T_zone_C"][:, :-1]])
    outside = [excess(T_C, columns["lower_C"], columns["upper_C"]) for T_C in (before_C, columns["T_zone_C"])]
    discomfort = 0.5 * (outside[0] + outside[1]) * columns["duration_s"] / HOUR_S
    cost = np.nancumsum(spent)
    bill = result.kpis.get("cost_tot", np.nan)
    two_carriers = not np.array_equal(np.array(heating_price).T, columns["price_per_kWh"])
    scaled = float(bill / cost[-1]) if two_carriers and bill > 0 and cost[-1] > 0 else 1.0
    columns |= {"cost": scaled * cost, "discomfort_Kh": np.nancumsum(discomfort, axis=1)}
    course = RunCourse(averaged=1, scaled=scaled, band_C=np.array(bands).transpose(2, 1, 0), **columns)
    return _averaged(course, -(-course.start_s.size // most))


def _band_C(step: StepRecord, k: int) -> Array:
    """Heating and cooling set-point of each actuator in the block number `k` of a step (A, 2), °C."""
    nothing = (np.nan, np.nan)
    refused = bool(step.refused) or k >= len(step.plan.blocks)
    bands = (None,) * len(step.boundary.names.actuators) if refused else step.plan.blocks[k].command
    return np.array([band if isinstance(band, tuple) else nothing for band in bands], dtype=np.float64)


def _averaged(course: RunCourse, together: int) -> RunCourse:
    """The course with `together` blocks taken as one: means of what acts, the last of what is sampled."""
    if together <= 1:
        return course
    first = np.arange(0, course.start_s.size, together)
    last = np.append(first[1:], course.start_s.size) - 1
    weight = np.add.reduceat(course.duration_s, first)

    def mean(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values * course.duration_s, first, axis=-1) / weight)

    def at(places: NDArray[np.intp], *names: str) -> dict[str, Array]:
        return {name: getattr(course, name)[..., places] for name in names}

    sampled = at(last, "T_out_C", "solar_W_m2", "T_zone_C", "cost", "discomfort_Kh")
    means = {name: mean(getattr(course, name)) for name in ("u", "power_W", "price_per_kWh")}
    begins = at(first, "start_s", "lower_C", "upper_C", "band_C")
    parts: dict[str, Any] = {**begins, **sampled, **means}
    return replace(course, duration_s=weight, averaged=together, **parts)
