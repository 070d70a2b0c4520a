"""`tf-mpc bench probing`: informative probing and online adaptation, all on the embedded plant.

The first part identifies from days of random or informative probing and scores the effect on pairs of probed runs. The
second runs the plant for weeks under an on/off thermostat; after the first third the heat pump has the output of a
compressor speed that is one fifth lower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from benchmarks.operator.data import FLOOR_AREA_M2, ReferencePair
from benchmarks.operator.score import score_pairs
from benchmarks.probing.pair_probing import probe_pair
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Measurement, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, Pair, identify
from thermoforce_mpc.identification.estimation.adaptation import AdaptationConfig, OnlineAdaptation
from thermoforce_mpc.identification.probing.design import Designer
from thermoforce_mpc.identification.probing.probe import ProbingConfig, probe
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.simulation.comparison.results_json import Target, results_json

_LEVELS = (0.0, 0.4, 0.7, 1.0)
_PAIR_DAYS, _START_DAYS = (12, 25, 40, 60, 75, 90, 300, 330), (18, 33, 50, 68, 83, 310)
_LINEAR = IdentificationConfig(modulation="linear")
# Thermostat of the second part: 21 °C ± 0.5 K, by night 1 K lower for excitation.
_SET_C, _BAND_K, _NIGHT_K = 21.0, 0.5, 1.0
_WEAKENED = 0.8
_WEEKS, _LATE_DAYS, _FOUND_WITHIN = 4, 7, 0.1

Row = dict[str, Any]


def run_probing_bench(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> dict[str, Any]:
    """Run all parts on the embedded plant with the synthetic year.

    Args:
        quick: fewer days and one seed.
        progress: callback for progress lines.
    """
    say = progress or (lambda text: None)
    plant = EmbeddedPlant(synthetic_weather())
    pairs = _pairs(plant, quick, say)
    rows, targets = _designs(plant, pairs, quick, say)
    more_rows, more_targets = _adaptation(plant, say)
    return results_json("probing", [*rows, *more_rows], [*targets, *more_targets])


def _pairs(plant: EmbeddedPlant, quick: bool, say: Callable[[str], None]) -> list[ReferencePair]:
    say("simulating pairs for scoring")
    config = ProbingConfig(design="random", warmup_days=2.0)
    pairs = []
    for day in _PAIR_DAYS[:4] if quick else _PAIR_DAYS:
        pair = probe_pair(plant, day * DAY_S, 1.25, seeds=(day, day + 1000), config=config)
        pairs.append(ReferencePair(day, "probed", 0, Pair(_hourly(pair.a), _hourly(pair.b))))
    return pairs


def _designs(
    plant: EmbeddedPlant, pairs: list[ReferencePair], quick: bool, say: Callable[[str], None]
) -> tuple[list[Row], list[Target]]:
    rows: list[Row] = []
    found: dict[tuple[int, str], list[float]] = {}
    designs: tuple[Literal["random", "informative"], ...] = ("random", "informative")
    for days in (1, 3):
        for design in designs:
            say(f"{days} days, {design}")
            errors, information, extremes, refused = [], [], [], 0
            for day in _START_DAYS[:2] if quick else _START_DAYS:
                for seed in (1,) if quick else (1, 2):
                    probing = ProbingConfig(design=design, levels=_LEVELS, warmup_days=3.0)
                    record = probe(plant, day * DAY_S, days, seed=seed, config=probing)
                    extremes += [float(record.T_zone_C.min()), float(record.T_zone_C.max())]
                    information.append(Designer().information(record))
                    try:
                        model = identify([record], config=_LINEAR, floor_area_m2=FLOOR_AREA_M2)
                    except DataError:
                        refused += 1
                        continue
                    errors.append(score_pairs(model.only.operator, pairs).rmse_K)
            found[days, design] = errors
            rows.append(
                {
                    "part": "probing",
                    "data": f"{days} days, {len(information)} records",
                    "draws": design,
                    "information_nats": float(np.mean(information)),
                    "mean_rmse_K": float(np.mean(errors)),
                    "worst_rmse_K": float(np.max(errors)),
                    "refused": refused,
                    "coldest_C": min(extremes),
                    "warmest_C": max(extremes),
                }
            )
    targets = [
        Target(
            f"{days} days: effect RMSE of chosen draws against random ones",
            float(np.mean(found[days, "informative"]) / np.mean(found[days, "random"])),
            1.0,
        )
        for days in (1, 3)
    ]
    return rows, targets


def _adaptation(plant: EmbeddedPlant, say: Callable[[str], None]) -> tuple[list[Row], list[Target]]:
    start_s = 15 * DAY_S
    say("adaptation: three days of probing")
    record = probe(plant, start_s - 5 * DAY_S, 3, seed=1, config=ProbingConfig(warmup_days=3.0))
    say(f"adaptation: {_WEEKS} weeks with a weakening machine")
    run = _thermostat(plant, start_s, _WEEKS * 7)
    rows, targets = [], []
    for measured in (True, False):
        given = record if measured else replace(record, heat_W=np.full_like(record.heat_W, np.nan))
        seen = run if measured else replace(run, heat_W=np.full_like(run.heat_W, np.nan))
        model = identify([given], config=_LINEAR, floor_area_m2=FLOOR_AREA_M2, step_s=HOUR_S)
        adapted = OnlineAdaptation(model.only, AdaptationConfig(enabled=True)).update(None, seen)
        # True change of the estimated gain, from the heat at full level in the first third and in the last days: for an
        # operator on u the whole change, for one on heat only the part not predicted by its load map.
        on, steps_from_start = run.u[0] > 0, np.arange(run.n_steps)
        early = on & (steps_from_start < run.n_steps // 3)
        late = on & (steps_from_start >= run.n_steps - round(_LATE_DAYS * DAY_S / run.step_s))
        load = model.only.operator.heat_input.heat
        expected = load(run.u[0], run.T_out_C[:-1]) if load else np.ones(run.n_steps)
        relative = run.heat_W[0] / np.where(on, expected, 1.0)
        true = float(relative[late].mean() / relative[early].mean())
        steps = adapted.steps
        before = [s for s in steps if s.time_s <= run.time_s[run.n_steps // 3]][-1]
        last = steps[-1]
        ratio = last.gain * last.heat / (before.gain * before.heat)
        name = "heat measured" if measured else "heat unknown"
        rows.append(
            {
                "part": "adaptation",
                "data": f"{_WEEKS} weeks of a thermostat, {name}",
                "true_change": true,
                "found_change": ratio,
                "gain": last.gain,
                "heat": last.heat,
                "gain_sd": last.gain_sd,
                "blocks_used": sum(s.outcome == "updated" for s in steps),
                "blocks": len(steps),
            }
        )
        targets.append(Target(f"adaptation, {name}: change of gain found, off by", abs(ratio - true), _FOUND_WITHIN))
    return rows, targets


def _thermostat(plant: EmbeddedPlant, start_s: float, days: int, step_s: float = 900.0) -> Record:
    """A run under an on/off thermostat, the machine weakened after the first third; u is the requested level."""
    now = plant.reset(start_s, 3 * DAY_S)
    history = Record.beginning(now)
    on, n = False, round(days * DAY_S / step_s)
    for t in range(n):
        hour = now.time_s / HOUR_S % 24
        wanted = _SET_C - (_NIGHT_K if hour < 6 or hour >= 22 else 0.0)
        on = float(now.T_zone_C[0]) < wanted + (_BAND_K if on else -_BAND_K)
        now = plant.advance(float(on) * (1.0 if t < n // 3 else _WEAKENED), step_s)
        history = history.extended(_asked(now, float(on)))
    return history


def _asked(measurement: Measurement, u: float) -> Measurement:
    return replace(measurement, u=np.array([u]))


def _hourly(run: Record) -> Record:
    return run.resample(round(HOUR_S / run.step_s))
