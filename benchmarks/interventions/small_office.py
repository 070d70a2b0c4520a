"""Simulation of the DOE small office (new 2004 construction, Chicago), a reference building shipped with the engine.

It has five conditioned zones, five rooftop units with ventilation, and schedules of people, lights and plugs. Only the
heating set-point of all zones is changed, by its schedule; the cooling set-point is 40 °C. The building is treated as
one zone: air temperature averaged by floor area, and the sum of the sensible heat of all units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.engine import (
    WEATHER_SENSORS,
    Reading,
    Wiring,
    run_engine,
    weather_file,
    weather_reading,
)
from thermoforce_mpc.plants.energyplus.office import BUILDING, WEATHER, ZONES, office_model

STEP_S = 900.0
FLOOR_AREA_M2 = {zone.engine_name: zone.floor_area_m2 for zone in ZONES}
# Sensible heat at u = 0 and u = 1, W; negative because ventilation removes heat with the burners off.
RANGE_W = (-10e3, 50e3)
_COOLING_C = 40.0
_ACTUATORS = {name: ("Schedule:Compact", "Schedule Value", name) for name in ("HTGSETP_SCH", "CLGSETP_SCH")}
_SENSORS = {
    f"{short}/{zone}": (f"Zone {variable}", zone)
    for zone in FLOOR_AREA_M2
    for short, variable in (
        ("T", "Mean Air Temperature"),
        ("heating", "Air System Sensible Heating Rate"),
        ("cooling", "Air System Sensible Cooling Rate"),
    )
}


@dataclass(frozen=True)
class OfficeJob:
    """A run from midnight of `first_day` with heating set-points `setpoint_C`, °C, one per 15-min step."""

    first_day: int
    setpoint_C: Array


def _read(value: Mapping[str, float]) -> Reading:
    total = sum(FLOOR_AREA_M2.values())
    T = sum(area * value[f"T/{zone}"] for zone, area in FLOOR_AREA_M2.items()) / total
    heat = sum(value[f"heating/{zone}"] - value[f"cooling/{zone}"] for zone in FLOOR_AREA_M2)
    return weather_reading(value, T, heat)


class _Recorder:
    """`Driver` that applies the set-points of a job and records the readings."""

    def __init__(self, job: OfficeJob) -> None:
        self._job = job
        self.before: Reading | None = None
        self.readings: list[Reading] = []

    @property
    def done(self) -> bool:
        return len(self.readings) == self._job.setpoint_C.size

    def begin(self, warming_up: bool) -> dict[str, float]:
        step = 0 if warming_up or self.done else len(self.readings)
        return {"HTGSETP_SCH": float(self._job.setpoint_C[step]), "CLGSETP_SCH": _COOLING_C}

    def end(self, warming_up: bool, read: Callable[[], Reading]) -> bool:
        if warming_up:
            self.before = read()
        elif not self.done:
            self.readings.append(read())
            return False
        return self.done


def simulate_office(job: OfficeJob) -> Record:
    """Run one job in this process; u is the sensible heat scaled by `RANGE_W`.

    Raises:
        PlantError: the engine rejected the model or stopped early, or the heat left `RANGE_W`.
    """
    days = -(-job.setpoint_C.size // round(DAY_S / STEP_S))
    recorder = _Recorder(job)
    wiring = Wiring(_SENSORS | WEATHER_SENSORS, _ACTUATORS, _read, suffix="idf")
    run_engine(office_model(job.first_day, days, round(HOUR_S / STEP_S)), weather_file(WEATHER), recorder, wiring)
    if not recorder.done or recorder.before is None:
        raise PlantError(f"EnergyPlus recorded {len(recorder.readings)} of {job.setpoint_C.size} steps and then ended")
    readings = [recorder.before, *recorder.readings]
    heat = np.array([r.heat_W for r in recorder.readings])
    u = (heat - RANGE_W[0]) / (RANGE_W[1] - RANGE_W[0])
    if u.min() < 0.0 or u.max() > 1.0:
        raise PlantError(f"{BUILDING}: heat from {heat.min():.0f} to {heat.max():.0f} W, expected {RANGE_W}")
    return Record(
        time_s=np.asarray(job.first_day * DAY_S + STEP_S * np.arange(len(readings), dtype=np.float64)),
        T_zone_C=np.array([r.T_zone_C for r in readings]),
        T_out_C=np.array([r.T_out_C for r in readings]),
        solar_W_m2=np.array([r.solar_W_m2 for r in readings]),
        u=u,
        power_W=np.full(u.size, np.nan),
        heat_W=heat,
    )
