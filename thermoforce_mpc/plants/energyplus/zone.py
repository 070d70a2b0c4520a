"""Single-zone house as an epJSON dictionary; a callback sets its only heat source or sink.

`zone.epJSON` holds all that its variants have in common. The heat enters as `OtherEquipment` (negative for cooling),
partly as radiation, so the room responds as to a radiator or a cooled ceiling. An ideal-loads system would reach the
set-point within one step.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import Any, Literal

EpJson = dict[str, dict[str, dict[str, Any]]]

HVAC = "HVAC"
GAINS = "GAINS"
ZONE = "ZONE"
# A year of 365 days, as TMY3 years, that begins on a Monday.
YEAR = 2018
# Height of the windows, m; share of `ZoneSpec.window_m2`, axis along the wall and middle, m, of each.
_WINDOW_HEIGHT_M = 1.5
_WINDOWS = {"South window": (1.0, "x", 4.0), "West window": (1.0 / 3.0, "y", 3.0)}


@dataclass(frozen=True)
class ZoneSpec:
    """Parameters of a single-zone house.

    Attributes:
        weather: part of the name of the TMY3 file, such as 'Chicago-OHare'.
        mode: 'heating' or 'cooling'.
        capacity_W: maximum heat flow of the source, W thermal.
        insulation_m: thickness of the walls' insulation, m (0.04 W/mK); the roof has 1.5 times as much.
        slab_m: thickness of the concrete floor inside the insulation, m.
        window_m2: area of the south window, m²; the west window has a third of it.
        window_shgc: solar heat gain coefficient of the glazing.
        gains_W: full internal gains, W.
        steps_per_hour: data steps per hour; the source is constant over a step.
        engine_steps_per_hour: zone time steps of the engine, a multiple of `steps_per_hour`. With 15-min zone time
            steps the engine subdivides only steps with large changes and reports their mean instead of their end, so
            the response to an action would depend on its size.
        floor_area_m2: floor area of the model, m².
    """

    weather: str
    mode: Literal["heating", "cooling"]
    capacity_W: float
    insulation_m: float
    slab_m: float = 0.10
    window_m2: float = 6.0
    window_shgc: float = 0.45
    gains_W: float = 400.0
    steps_per_hour: int = 4
    engine_steps_per_hour: int = 12
    floor_area_m2: float = 48.0

    @property
    def step_s(self) -> float:
        """Length of a data step, s."""
        return 3600.0 / self.steps_per_hour


def zone_model(spec: ZoneSpec, first_day: int, days: int) -> EpJson:
    """Return the model of `spec` for a run of `days` from `first_day` (0 is 1 January) of a year without leap day."""
    model: EpJson = json.loads(Path(__file__).with_name("zone.epJSON").read_text(encoding="utf-8"))
    begin = date(YEAR, 1, 1) + timedelta(days=first_day)
    for name, day in (("begin", begin), ("end", begin + timedelta(days=days - 1))):
        parts = {"month": day.month, "day_of_month": day.day, "year": day.year}
        model["RunPeriod"]["Run"] |= {f"{name}_{part}": value for part, value in parts.items()}
    model["Timestep"]["Timestep 1"]["number_of_timesteps_per_hour"] = spec.engine_steps_per_hour
    materials = model["Material"]
    materials["Wall insulation"]["thickness"] = materials["Floor insulation"]["thickness"] = spec.insulation_m
    materials["Roof insulation"]["thickness"] = 1.5 * spec.insulation_m
    materials["Slab"]["thickness"] = spec.slab_m
    model["WindowMaterial:SimpleGlazingSystem"]["Glazing"]["solar_heat_gain_coefficient"] = spec.window_shgc
    for name, (share, axis, middle_m) in _WINDOWS.items():
        window, half_m = model["FenestrationSurface:Detailed"][name], share * spec.window_m2 / _WINDOW_HEIGHT_M / 2.0
        for corner in (f"vertex_{i}_{axis}_coordinate" for i in range(1, 5)):
            window[corner] = middle_m + (half_m if window[corner] > middle_m else -half_m)
    return model
