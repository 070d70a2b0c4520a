"""Control-free temperature series for the free-response bench, none from the generator of the training series.

A reference folder has the layout of docs/evidence/plant.md (records of the real BOPTEST test case); a folder of
houses holds the measured Mons house (Candanedo, Feldheim and Deramaix 2018). The embedded plant needs no folder.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.factual.readers import MONS, MONS_ROOMS, mons_table
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.protocols import Plant

# Time constants of the forced response that is subtracted from the controlled records; least squares with them has an
# RMSE of 0.02 K on held-out pairs.
_FORCED_TAU_H = np.array([0.45, 3.0, 48.0])
# First days of the free runs; seed of houses, none of which is in any training data.
_SEASONS = {"winter": 20, "spring": 100}
_POPULATION = 2044
_ROOMS = ("kitchen", "living room", "office", "bedroom")


@dataclass(frozen=True)
class Source:
    """One series.

    Targets are stated per `group`. `free_C` (n + 1,) is the control-free temperature at the step boundaries of
    `history`, °C. Forecasts over `horizon_h` hours get `least_context_steps` to `context_steps` steps of context.
    """

    name: str
    group: str
    history: Record
    free_C: Array
    context_steps: int
    least_context_steps: int
    horizon_h: float = 24.0

    @property
    def horizon(self) -> int:
        """Number of steps of a forecast."""
        return round(self.horizon_h * HOUR_S / self.history.step_s)


def boptest_sources(folder: Path) -> list[Source]:
    """Records of the real test case: 28-day runs (excitation, native control) minus forced response, and a free run.

    Raises:
        DataError: a file of the folder is missing.
    """
    gains = forced_gains(folder)
    sources = []
    for name in ("excite_jan", "excite_mar", "excite_apr", "native_d7_28d"):
        history, free = hourly_record(_existing(folder / f"{name}.csv.gz"), gains)
        sources.append(Source(name, "BOPTEST", history, free, context_steps=14 * 24, least_context_steps=7 * 24))
    off, free = hourly_record(_existing(folder / "off_d20_6d.csv.gz"))
    sources.append(Source("off_d20_6d", "BOPTEST off", off, free, context_steps=14 * 24, least_context_steps=3 * 24))
    return sources


def mons_sources(folder: Path) -> list[Source]:
    """Four rooms of the measured house, 30-min means.

    Sunlight was not measured; it is estimated from humidity and NaN on days without humidity.
    """
    frame, seconds, outdoor, solar = mons_table(_existing(folder / MONS))
    nothing = np.full(seconds.size - 1, np.nan)
    sources = []
    for room in _ROOMS:
        measured = frame[MONS_ROOMS[room]].to_numpy(float)
        history = Record(seconds, measured, outdoor, solar, nothing, nothing, nothing)
        sources.append(
            Source(f"Mons {room}", "Mons", history, measured, context_steps=14 * 48, least_context_steps=7 * 48)
        )
    return sources


def embedded_sources(step_s: float = HOUR_S, horizon_h: float = 24.0, people: int | None = None) -> list[Source]:
    """Free runs of the embedded plant under the synthetic year, machine off throughout: winter and spring.

    `people`: seed of people who do not keep to the schedule.
    """
    from thermoforce_mpc.boundary.weather import synthetic_weather
    from thermoforce_mpc.plants.embedded import EmbeddedPlant

    plant = EmbeddedPlant(synthetic_weather(), people=people)
    return [
        _free_run(plant, f"embedded {season}{_living(people)}", f"embedded{_living(people)}", day, step_s, horizon_h)
        for season, day in _SEASONS.items()
    ]


def house_sources(people: int | None = None, houses: int = 4) -> list[Source]:
    """Hourly free runs of generated houses, in winter and spring, as their sensors read them; `people` as above."""
    from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house

    sources = []
    for index in range(houses):
        plant = GeneratedHousePlant(draw_house(_POPULATION, index), people=people)
        for season, day in _SEASONS.items():
            name = f"house {_POPULATION}:{index} {season}{_living(people)}"
            sources.append(_free_run(plant, name, f"houses{_living(people)}", day, HOUR_S))
    return sources


def _living(people: int | None) -> str:
    return "" if people is None else ", people"


def _free_run(plant: Plant, name: str, group: str, day: int, step_s: float, horizon_h: float = 24.0) -> Source:
    """28 days with the machine off, after a week of native control before `day`."""
    per_day = round(DAY_S / step_s)
    rows = [plant.reset(day * DAY_S, 7 * DAY_S)]
    rows += [plant.advance(0.0, step_s) for _ in range(28 * per_day)]
    time_s, T, T_out, solar = (
        np.stack([getattr(row, key) for row in rows], axis=-1)
        for key in ("time_s", "T_zone_C", "T_out_C", "solar_W_m2")
    )
    off = np.zeros(time_s.size - 1)
    history = Record(time_s, T, T_out, solar, off, off, off)
    return Source(name, group, history, T[0], 14 * per_day, 7 * per_day, horizon_h)


def hourly_record(path: Path, gains: Array | None = None) -> tuple[Record, Array]:
    """A 15-min record of the test case at hourly boundaries, and its temperature minus the forced response, °C.

    The forced response with `gains` is computed at 15 min, since the machine switches within the hour.
    """
    frame = pd.read_csv(path)
    time_s = frame["time"].to_numpy(float)
    boundary = np.flatnonzero(time_s % HOUR_S == 0)
    power = frame[["reaPHeaPum_y", "reaPFan_y", "reaPPumEmi_y"]].sum(axis=1).to_numpy(float)

    def hour_mean(values: Array) -> Array:
        return np.array([values[a + 1 : b + 1].mean() for a, b in pairwise(boundary)])

    history = Record(
        time_s=time_s[boundary],
        T_zone_C=frame["reaTZon_y"].to_numpy(float)[boundary],
        T_out_C=frame["weaSta_reaWeaTDryBul_y"].to_numpy(float)[boundary],
        solar_W_m2=frame["weaSta_reaWeaHGloHor_y"].to_numpy(float)[boundary],
        u=hour_mean(frame["oveHeaPumY_u"].to_numpy(float)),
        power_W=hour_mean(power),
        heat_W=hour_mean(frame["reaQHeaPumCon_y"].to_numpy(float)),
    )
    if gains is None:
        return history, history.T_zone_C[0]
    # The heat of row i acts until the time of row i; the first row is only used for the initial state.
    forced = forced_temperature(frame["reaQHeaPumCon_y"].to_numpy(float), gains)[1:]
    return history, np.asarray(history.T_zone_C[0] - forced[boundary])


def forced_gains(folder: Path) -> Array:
    """Steady-state gain of each mode, K/W, by least squares on the hourly pairs, shape (modes,)."""
    frame = pd.read_csv(_existing(folder / "pairs" / "pairs_1h.csv.gz"))
    rows, effects = [], []
    for _, pair in frame.groupby("pair"):
        extra = pair["QB_W"].to_numpy(float) - pair["QA_W"].to_numpy(float)
        rows.append(_mode_states(extra, 1.0, np.zeros(_FORCED_TAU_H.size))[1:])
        effects.append(pair["TB_end"].to_numpy(float) - pair["TA_end"].to_numpy(float))
    return np.asarray(np.linalg.lstsq(np.concatenate(rows), np.concatenate(effects), rcond=None)[0])


def forced_temperature(heat_W: Array, gains: Array, step_h: float = 0.25) -> Array:
    """F at the step boundaries of `heat_W` (n,), K, shape (n + 1,), from the steady state of the first day's mean."""
    steady = np.full(_FORCED_TAU_H.size, heat_W[: round(24 / step_h)].mean())
    return np.asarray(_mode_states(heat_W, step_h, steady) @ gains)


def _mode_states(heat_W: Array, step_h: float, start_W: Array) -> Array:
    """States of first-order modes of unit steady-state gain, driven by heat, shape (n + 1, modes), W."""
    poles = np.exp(-step_h / _FORCED_TAU_H)
    states = np.empty((heat_W.size + 1, poles.size))
    states[0] = start_W
    for t, heat in enumerate(heat_W):
        states[t + 1] = poles * states[t] + (1.0 - poles) * heat
    return states


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise DataError(f"{path} is missing: give a folder of reference data in the layout of docs/evidence/plant.md")
    return path
