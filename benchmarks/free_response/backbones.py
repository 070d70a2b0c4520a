"""`tf-mpc bench backbones`: accuracy of the free/forced decomposition with different forecasters.

Every backbone forecasts controlled records of buildings 6 h ahead from many origins: alone (raw), from the measured
temperature, and composed, from T - F plus the forced response of the applied actions (paper, table 'Backbone
generality'). The operator is identified on the first three days of each record.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.free_response.scales import SCALES, backbone_of
from benchmarks.operator.data import FLOOR_AREA_M2, cut, read_run
from benchmarks.parameter_count import parameter_count
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Observation, Record
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.model.free_response.backbones.loading import FRACAST
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel

_PROBE_DAYS, _CONTEXT_DAYS, _EMBEDDED_DAYS = 3, 7, 16
_HORIZON_H = 6
_ORIGINS, _ORIGINS_QUICK = 60, 8
_EMBEDDED_STARTS: Mapping[str, int] = {"embedded winter": 20, "embedded spring": 100}
_REFERENCE_RUNS = ("excite_jan", "excite_mar", "excite_apr")


@dataclass(frozen=True)
class Building:
    """A controlled 15-min record, the operator identified on its first days, and forecast origins (step indices)."""

    name: str
    record: Record
    model: ThermalModel
    origins: tuple[int, ...]

    @property
    def horizon(self) -> int:
        """Number of steps of a forecast."""
        return round(_HORIZON_H * HOUR_S / self.record.step_s)


def default_backbones() -> list[str]:
    """The shipped forecaster at its scales, and `fracast` if its package is installed."""
    return [*SCALES, *([FRACAST] if importlib.util.find_spec(FRACAST) else [])]


def run_backbone_bench(
    backbones: Sequence[str] = (),
    reference: Path | None = None,
    *,
    records: Mapping[str, Record] | None = None,
    origins: int = _ORIGINS,
    quick: bool = False,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Score every backbone raw and composed on every record.

    Args:
        backbones: names, directories or hub names as in `load_backbone`; by default `default_backbones()`.
        reference: folder of records of the real test case in the layout of docs/evidence/plant.md; optional.
        records: controlled 15-min records by name in the place of those of `embedded_records`.
        origins: number of forecasts per record.
        quick: at most 8 forecasts per record.
        out: folder for the plot `backbones.png`; no plot if None.
        progress: callback for progress lines.

    Raises:
        BackboneError: a backbone cannot be loaded.
        DataError: the folder lacks a file.
    """
    # All backbones are loaded first, so that a wrong name fails before the computation.
    loaded = {name: ChronosFreeResponse(backbone_of(name)) for name in backbones or default_backbones()}
    controlled = dict(embedded_records() if records is None else records)
    if reference is not None:
        controlled |= {name: read_run(reference / f"{name}.csv.gz") for name in _REFERENCE_RUNS}
    buildings = _buildings(controlled, min(origins, _ORIGINS_QUICK) if quick else origins, progress)
    rows: list[dict[str, Any]] = []
    for name, backbone in loaded.items():
        own = [_row(name, backbone, building) for building in buildings]
        middle = {key: float(np.median([row[key] for row in own])) for key in _FIGURES}
        middle["change_percent"] = _change(middle)
        rows += [*own, {**own[0], "record": f"median of {len(own)}", **middle}]
        progress(f"{name}: raw {middle['raw_rmse_K']:.3f} K, composed {middle['composed_rmse_K']:.3f} K")
    targets = [
        Target(
            f"{name}: composed RMSE over raw, worst record",
            max(row["composed_rmse_K"] / row["raw_rmse_K"] for row in rows if row["backbone"] == name),
            1.0,
        )
        for name in loaded
    ]
    if out is not None:
        _plot(rows, out)
    return results_json("backbones", rows, targets)


_FIGURES = ("raw_rmse_K", "composed_rmse_K", "change_percent", "with_weather_rmse_K", "ms")


def _row(name: str, backbone: ChronosFreeResponse, building: Building) -> dict[str, Any]:
    raw, composed, milliseconds = [], [], []
    weather: list[Array] = []
    residual = ChronosFreeResponse(backbone.backbone, after_linear_weather=True)
    for origin in building.origins:
        observation, u, truth = _instant(building, origin)
        history, boundary = observation.history, observation.boundary
        began = time.perf_counter()
        alone = backbone.forecast(history.T_zone_C[0], history, boundary).median_C
        milliseconds.append((time.perf_counter() - began) * 1e3)
        raw.append(alone - truth)
        composed.append(Predictor(building.model.operator, backbone).context(observation).predict(u).total_C[0] - truth)
        weather.append(Predictor(building.model.operator, residual).context(observation).predict(u).total_C[0] - truth)
    row = {
        "backbone": name,
        "parameters": parameter_count(backbone.model),
        "record": building.name,
        "raw_rmse_K": _rmse(raw),
        "composed_rmse_K": _rmse(composed),
    }
    return row | {
        "change_percent": _change(row),
        "with_weather_rmse_K": _rmse(weather),
        "ms": float(np.median(milliseconds)),
    }


def _instant(building: Building, origin: int) -> tuple[Observation, Array, Array]:
    """Observation at step `origin` of the record, following actions (1, N) and temperatures (N,), °C."""
    record, n = building.record, building.horizon
    first = max(0, origin - round(_CONTEXT_DAYS * DAY_S / record.step_s))
    ahead = record.slice(origin, origin + n)
    return Observation(record.slice(first, origin), Boundary.measured(ahead)), ahead.u, ahead.T_zone_C[0, 1:]


def _buildings(records: Mapping[str, Record], at_most: int, progress: Callable[[str], None]) -> list[Building]:
    buildings = []
    for name, record in records.items():
        model = identify(
            [cut(record, 0.0, _PROBE_DAYS)],
            config=IdentificationConfig(modulation="linear"),
            floor_area_m2=FLOOR_AREA_M2,
        )
        first = round(_CONTEXT_DAYS * DAY_S / record.step_s)
        last = record.n_steps - round(_HORIZON_H * HOUR_S / record.step_s)
        origins = tuple(int(t) for t in np.linspace(first, last, at_most).round())
        buildings.append(Building(name, record, model, origins))
        progress(f"{name}: operator identified on {_PROBE_DAYS} days, {len(origins)} origins")
    return buildings


def embedded_records(starts: Mapping[str, int] = _EMBEDDED_STARTS, days: float = _EMBEDDED_DAYS) -> dict[str, Record]:
    """Records of `days` of the embedded plant under random probing, by name, from start days of the synthetic year."""
    from thermoforce_mpc.boundary.weather import synthetic_weather
    from thermoforce_mpc.identification.probing.probe import ProbingConfig
    from thermoforce_mpc.loop.probing import probe
    from thermoforce_mpc.plants.embedded import EmbeddedPlant

    plant = EmbeddedPlant(synthetic_weather())
    try:
        config = ProbingConfig(design="random", warmup_days=3.0)
        return {name: probe(plant, day * DAY_S, days, seed=day, config=config) for name, day in starts.items()}
    finally:
        plant.close()


def _rmse(errors: Sequence[Array]) -> float:
    return float(np.sqrt(np.nanmean(np.square(errors))))


def _change(row: dict[str, Any]) -> float:
    return 100.0 * (row["composed_rmse_K"] / row["raw_rmse_K"] - 1.0)


def _plot(rows: Sequence[dict[str, Any]], out: Path) -> None:
    """Plot medians over the records: raw, composed and composed with weather, one group of bars per backbone."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    medians = [row for row in rows if row["record"].startswith("median")]
    figure, axis = plt.subplots(figsize=(2.0 + 1.6 * len(medians), 3.4), layout="constrained")
    kinds = {"raw_rmse_K": "raw", "composed_rmse_K": "composed", "with_weather_rmse_K": "composed, weather known"}
    for index, (key, label) in enumerate(kinds.items()):
        axis.bar(np.arange(len(medians)) + 0.27 * (index - 1), [row[key] for row in medians], 0.25, label=label)
    names = [f"{Path(row['backbone']).name}\n{row['parameters'] / 1e6:.2f} M" for row in medians]
    axis.set_xticks(np.arange(len(medians)), names, fontsize=8)
    axis.set(ylabel=f"RMSE over {_HORIZON_H} h, K")
    figure.legend(loc="outside upper center", ncols=3, fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "backbones.png", dpi=130)
    plt.close(figure)
