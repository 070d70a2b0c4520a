"""Data passed between plant, forecaster, predictor and controller.

Time is in seconds since 1 January 00:00 (BOPTEST's clock). `N` steps have `N + 1` boundaries: what is *sampled*
(temperatures, weather, comfort bounds) has `N + 1` values, what *acts over a step* (u, power, heat) has `N`.
Temperatures are in °C, differences and effects in K, powers and heat flows in W, energies in kWh, u in [0, 1].

A building has Z zones, A actuators and M machines, whose names travel with the arrays (`Names`). Time is the last
axis: zone temperatures and bounds are (Z, …), levels and heat (A, …), power and prices (M, …), the weather (…). Where
there is one of them, constructors also take arrays without that axis.
"""

from __future__ import annotations

from thermoforce_mpc.data.boundary import AT_THE_METER, CONDITIONS, Boundary, FreeForecast, Observation
from thermoforce_mpc.data.clock import (
    DAY_S,
    HOUR_S,
    J_PER_KWH,
    NORMAL_90,
    NORMAL_95,
    YEAR_S,
    ZERO_C_K,
    Array,
    cost_per_W,
    energy_kWh,
    month_of,
    steps_in,
)
from thermoforce_mpc.data.layout import Layout, Period, PlantInfo
from thermoforce_mpc.data.names import SINGLE, Names
from thermoforce_mpc.data.plan import (
    Block,
    Commands,
    CommandValue,
    HeldCommand,
    HotWaterPlan,
    Levels,
    Plan,
    PlannedSaving,
    PlanStatus,
    commands_of_each,
)
from thermoforce_mpc.data.record import ACTING, SAMPLED, SIGNALS, Measurement, Record

__all__ = [
    "ACTING",
    "AT_THE_METER",
    "CONDITIONS",
    "DAY_S",
    "HOUR_S",
    "J_PER_KWH",
    "NORMAL_90",
    "NORMAL_95",
    "SAMPLED",
    "SIGNALS",
    "SINGLE",
    "YEAR_S",
    "ZERO_C_K",
    "Array",
    "Block",
    "Boundary",
    "CommandValue",
    "Commands",
    "FreeForecast",
    "HeldCommand",
    "HotWaterPlan",
    "Layout",
    "Levels",
    "Measurement",
    "Names",
    "Observation",
    "Period",
    "Plan",
    "PlanStatus",
    "PlannedSaving",
    "PlantInfo",
    "Record",
    "commands_of_each",
    "cost_per_W",
    "energy_kWh",
    "month_of",
    "steps_in",
]  # fmt: skip
