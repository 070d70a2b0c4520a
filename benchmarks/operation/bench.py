"""`tf-mpc bench operation`: what records of ordinary operation tell about the effect of acting, beside probing.

A building is run by a thermostat, a PI loop or a timer with an outdoor curve, and probed; from the last days of each
record a model is identified. Its effect is scored on pairs of days that the building was run both ways (paper
eq:paired), none of which was identified from. Temperatures, weather, levels and power are measured, heat is not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Layout, Measurement, Record
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.model.free_response.linear_weather import Persistence
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.rooms import HouseOfRooms, house_of_rooms

Row = dict[str, Any]

EMBEDDED, ROOMS = "embedded plant", "house:3rooms"
OPERATIONS, PROBING = ("thermostat", "PI loop", "timer and outdoor curve"), "probing"
DAYS, PROBING_DAYS = (3, 7, 28), (1, 3)
_STARTS = (8, 36)  # days of the year; the record ends 28 days later
_PAIR_DAYS, _BLOCK_H, _WARMUP_S = (12, 45, 75, 320), 4.0, 3 * DAY_S
_STEP_S = 900.0
# Kept at this temperature, °C, 1 K less by night, by a hysteresis of ± 0.3 K or a PI loop: gain 1/K, integral time, h.
_SET_C, _NIGHT_K, _BAND_K, _GAIN, _INTEGRAL_H = 21.0, 1.0, 0.3, 0.5, 4.0
# From this share of the effect on, the error makes a model useless for planning.
_USELESS = 0.5
_LINEAR = IdentificationConfig(modulation="linear")


@dataclass(frozen=True)
class Case:
    """A building under one operation from a start day on."""

    building: str
    operation: str
    start_day: int
    days: tuple[int, ...]


def run_operation_bench(
    *, engine: Engine, quick: bool = False, progress: Callable[[str], None] = lambda line: None
) -> dict[str, Any]:
    """Run all buildings, operations and lengths.

    Args:
        engine: where the cases are run.
        quick: the embedded plant, one start and up to 7 days.
        progress: callback for progress lines.
    """
    buildings, starts = ((EMBEDDED,), _STARTS[:1]) if quick else ((EMBEDDED, ROOMS), _STARTS)
    days = tuple(k for k in DAYS if not quick or k <= 7)
    cases = [
        Case(building, operation, start, PROBING_DAYS if operation == PROBING else days)
        for building, operation, start in product(buildings, (*OPERATIONS, PROBING), starts)
    ]

    def told(done: int, found: list[Row]) -> None:
        first = found[0]
        progress(f"{done} of {len(cases)}: {first['building']}, {first['operation']}, day {first['start_day']}")

    found = [row for rows in run_all(run_case, cases, engine, told) for row in rows]
    return results_json("operation", summary(found), targets(found))


def run_case(case: Case) -> list[Row]:
    """Identify from the last days of one record, for each number of days, and score the effect on pairs."""
    plant, layout = _building(case.building)
    longest = max(case.days)
    if case.operation == PROBING:
        config = ProbingConfig(warmup_days=3.0)
        probed = probe(plant, case.start_day * DAY_S, longest, seed=1, layout=layout, config=config)
        record = as_usually_measured(_hourly(probed))
    else:
        record = as_usually_measured(operated(plant, layout, case.operation, case.start_day * DAY_S, longest))
    pairs = [pair_of_days(plant, layout, day) for day in _PAIR_DAYS]
    rows = []
    for days in case.days:
        steps = round(days * DAY_S / record.step_s)
        # A shorter probing is the beginning of a longer one, a shorter operation its end.
        part = record.slice(0, steps) if case.operation == PROBING else record.last(steps)
        row: Row = {
            "building": case.building, "operation": case.operation, "start_day": case.start_day, "days": days,
            "rmse_K": float("nan"), "share": float("nan"), "competent": False, "why": "",
        }  # fmt: skip
        try:
            model = identify(part, config=_LINEAR, layout=layout)
        except DataError as error:
            rows.append(row | {"why": f"refused: {error}"})
            continue
        rmse, effect = score(model, pairs)
        verdicts = [card.competence for card in model.cards]
        missed = [reason for verdict in verdicts if verdict is not None for reason in verdict.reasons]
        competent = all(verdict is not None and verdict.competent for verdict in verdicts)
        rows.append(row | {"rmse_K": rmse, "share": rmse / effect, "competent": competent, "why": "; ".join(missed)})
    return rows


def score(model: ThermalModel, pairs: list[tuple[Record, Record]]) -> tuple[float, float]:
    """RMSE of the model's effect and RMS of the true one over all zones and hours of the pairs, K."""
    predictor = Predictor(model.operator, Persistence(), initial_force="zero")
    errors, effects = [], []
    for one, other in pairs:
        predicted = (predictor.forced_history(one) - predictor.forced_history(other)).sum(axis=(1, 3))
        true = one.T_zone_C - other.T_zone_C
        errors.append(predicted - true)
        effects.append(true)
    return rms(errors), rms(effects)


def summary(found: list[Row]) -> list[Row]:
    """Mean over the starts, one row per building, operation and number of days."""
    rows = []
    for (building, operation, days), of in _groups(found):
        known = [row for row in of if np.isfinite(row["rmse_K"])]
        rows.append(
            {
                "building": building,
                "operation": operation,
                "days": days,
                "effect_rmse_K": float(np.mean([row["rmse_K"] for row in known])) if known else None,
                "share_of_effect": float(np.mean([row["share"] for row in known])) if known else None,
                "model": f"{len(known)} of {len(of)}",
                "competent": f"{sum(row['competent'] for row in of)} of {len(of)}",
                "what it says": next((row["why"].split(";")[0] for row in of if row["why"]), ""),
            }
        )
    return rows


def targets(found: list[Row]) -> list[Target]:
    """A record that cannot tell must say so; the rest is for the table."""
    trusted = [row for row in found if row["competent"]]
    wrong = [row for row in trusted if row["share"] > _USELESS]
    worst = max((row["share"] for row in trusted), default=0.0)
    return [
        Target(f"of {len(trusted)} models called competent, wrong by more than half of the effect", len(wrong), 0),
        Target("worst error of a model called competent, share of the effect", worst, _USELESS),
    ]


def operated(plant: EmbeddedPlant | HouseOfRooms, layout: Layout, operation: str, start_s: float, days: int) -> Record:
    """Hourly record of `days` under an operation of `OPERATIONS`, each actuator by its zone."""
    now = plant.reset(start_s, _WARMUP_S)
    n = len(layout.home)
    on, total = np.zeros(n, dtype=bool), np.full(n, 0.3)
    for _ in range(round(days * DAY_S / _STEP_S)):
        T = now.T_zone_C[list(layout.home)]
        hour = now.time_s / HOUR_S % 24
        target = _SET_C - (_NIGHT_K if hour < 6 or hour >= 22 else 0.0)
        if operation == "thermostat":
            on = target + np.where(on, _BAND_K, -_BAND_K) > T
            u = on.astype(np.float64)
        elif operation == "PI loop":
            total = np.clip(total + _GAIN * (target - T) * _STEP_S / HOUR_S / _INTEGRAL_H, 0.0, 1.0)
            u = np.clip(_GAIN * (target - T) + total, 0.0, 1.0)
        else:
            u = np.full(n, _timed(now, hour))
        now = plant.advance(tuple(u.tolist()), _STEP_S)
    return _since(plant.past(HOUR_S), start_s)


def _timed(now: Measurement, hour: float) -> float:
    """Level of a timer with an outdoor curve: full at −10 °C, off at 18 °C, halved by night."""
    level = float(np.clip((18.0 - now.T_out_C) / 28.0, 0.0, 1.0))
    return level if 5 <= hour < 22 else 0.5 * level


def pair_of_days(plant: EmbeddedPlant | HouseOfRooms, layout: Layout, day: int) -> tuple[Record, Record]:
    """A day under two draws of levels, from one state and in one weather."""
    records = []
    for seed in (day, day + 1000):
        rng = np.random.default_rng(seed)
        plant.reset(day * DAY_S, _WARMUP_S)
        for _ in range(round(24 / _BLOCK_H)):
            u = rng.choice([0.0, 0.4, 0.7, 1.0], len(layout.home))
            for _ in range(round(_BLOCK_H * HOUR_S / _STEP_S)):
                plant.advance(tuple(u.tolist()), _STEP_S)
        records.append(_since(plant.past(HOUR_S), day * DAY_S))
    return records[0], records[1]


def _building(name: str) -> tuple[EmbeddedPlant | HouseOfRooms, Layout]:
    if name == EMBEDDED:
        return EmbeddedPlant(synthetic_weather()), Layout.single()
    plant = house_of_rooms(name)
    return plant, plant.layout


def _since(record: Record, start_s: float) -> Record:
    first = int(np.flatnonzero(record.time_s >= start_s - 1.0)[0])
    return record.slice(first, record.n_steps)


def as_usually_measured(record: Record) -> Record:
    """The record without heat and return water, which few people measure."""
    return replace(
        record, heat_W=np.full_like(record.heat_W, np.nan), T_return_C=np.full_like(record.T_return_C, np.nan)
    )


def _hourly(record: Record) -> Record:
    return record.resample(round(HOUR_S / record.step_s))


def _groups(found: list[Row]) -> Iterator[tuple[tuple[str, str, int], list[Row]]]:
    keys = dict.fromkeys((row["building"], row["operation"], row["days"]) for row in found)
    for key in keys:
        yield key, [row for row in found if (row["building"], row["operation"], row["days"]) == key]
