"""`tf-mpc bench free-response`: forecasters of the control-free temperature on series not used in their design."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.free_response import energyplus
from benchmarks.free_response.baselines.autoregressive import Autoregressive
from benchmarks.free_response.baselines.exponential_smoothing import ExponentialSmoothing
from benchmarks.free_response.baselines.seasonal_naive import SeasonalNaive
from benchmarks.free_response.runs import cost_rows, gap_rows, interval_runs, look_rows
from benchmarks.free_response.score import Score, forecast_origins, mae_K, score
from benchmarks.free_response.shares import share_rows
from benchmarks.free_response.sources import Source, boptest_sources, embedded_sources, house_sources, mons_sources
from thermoforce_mpc.boundary.forecast_error import ForecastError, Level
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.protocols import FreeResponse

# Baselines of the shipped forecaster: same context, no weather.
NAIVE = ("persistence", "seasonal_naive", "ar26", "ar49", "ets")
_ORIGINS_PER_SOURCE = 60
_ORIGINS_SHARED = 30
_ORIGINS_QUICK = 8
# Seed of people whom no training data knows.
PEOPLE = 7
# Methods with weather are also scored with BOPTEST's forecast errors, on the hourly records of the test case.
_LEVELS: tuple[Level, ...] = ("low", "medium", "high")
_WEATHER_AWARE = ("arx26", "linear_weather", "residual")
_ERROR_SEED = 1


def run_free_response_bench(
    reference: Path | None = None,
    houses: Path | None = None,
    *,
    backbone: str = "shipped",
    quick: bool = False,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Forecast 24 h from many origins on every source with every method.

    The weather forecast is the measured weather. On the records of the test case, methods with weather are also scored
    with BOPTEST's low, medium and high forecast errors.

    Args:
        reference: folder of records of the real test case in the layout of docs/evidence/plant.md; optional.
        houses: folder with `mons_house_30min.csv.gz`; optional.
        backbone: weights of `chronos`, as in `build_free_response`; `residual` has its own.
        quick: fewer origins, without the two-week runs.
        out: folder for the plot `free_response.png`; no plot if None.
        progress: callback for progress lines.

    Raises:
        DataError: a folder was given but a file in it is missing.
        BackboneError: the weights cannot be loaded.
        ConfigError: the extra [bench] is not installed.
    """
    methods = _methods(backbone)
    sources = embedded_sources()
    if energyplus.is_available():
        with LocalEngine(1) as engine:
            sources += energyplus.energyplus_sources(engine)
    else:
        progress("EnergyPlus left out: not installed (pip install -e '.[energyplus]')")
    sources += boptest_sources(reference) if reference else []
    sources += mons_sources(houses) if houses else []
    scores: dict[str, dict[str, Score]] = {}
    rows: list[dict[str, Any]] = []
    uncertain: dict[Level, dict[str, list[Score]]] = {level: {name: [] for name in _WEATHER_AWARE} for level in _LEVELS}
    for source in sources:
        origins = forecast_origins(source, _ORIGINS_QUICK if quick else _ORIGINS_PER_SOURCE)
        scores[source.name] = {}
        for name, method in methods.items():
            try:
                found = scores[source.name][name] = score(method, source, origins)
                rows.append(_row(source, name, found))
            except DataError as error:  # methods that need more history than a source has are skipped
                progress(f"{source.name}: {name} left out: {error}")
        for level in _LEVELS if source.group == "BOPTEST" else ():
            for name in _WEATHER_AWARE:
                found = score(methods[name], source, origins, ForecastError(level, level, _ERROR_SEED))
                uncertain[level][name].append(found)
                rows.append(_row(source, name, found, weather=level))
        progress(f"{source.name}: {len(origins)} origins")
    runs: tuple[list[dict[str, Any]], list[Target]] = ([], [])
    if not quick:
        runs = interval_runs([s for s in sources if s.group != "Mons"], progress)
    shares = share_rows(
        [*sources, *embedded_sources(people=PEOPLE), *house_sources(), *house_sources(people=PEOPLE)],
        {name: methods[name] for name in ("persistence", "chronos", *_WEATHER_AWARE)},
        _ORIGINS_QUICK if quick else _ORIGINS_SHARED,
        progress,
    )
    looks = look_rows(backbone, _ORIGINS_QUICK if quick else _ORIGINS_PER_SOURCE)
    gaps = gap_rows(
        [source for source in sources if source.history.step_s == HOUR_S],
        {name: methods[name] for name in ("chronos", "linear_weather", "residual")},
        _ORIGINS_QUICK if quick else _ORIGINS_SHARED,
    )
    costs = cost_rows(sources[0], backbone)
    groups = {source.name: source.group for source in sources}
    if out is not None:
        _plot(scores, groups, out)
    targets = [
        *_targets(scores, groups),
        *_uncertainty_targets(scores, groups, uncertain),
        Target("chronos: median processor ms per 24-h forecast", costs[0]["processor_ms"], 5.0),
        *runs[1],
    ]
    return results_json("free-response", [*rows, *runs[0], *shares, *looks, *gaps, *costs], targets)


def _methods(backbone: str) -> dict[str, FreeResponse]:
    return {
        "persistence": build_free_response("persistence"),
        "seasonal_naive": SeasonalNaive(),
        "ar26": Autoregressive(26),
        "ar49": Autoregressive(49),
        "ets": ExponentialSmoothing(),
        "chronos": build_free_response("chronos", backbone=backbone),
        "arx26": Autoregressive(26, weather=True),
        "linear_weather": build_free_response("linear_weather"),
        "residual": build_free_response("residual", calibrate=False),
    }


def _row(source: Source, method: str, found: Score, weather: str | None = None) -> dict[str, Any]:
    return {
        "source": source.name,
        "group": source.group,
        "method": method,
        "weather": weather or ("not used" if method in (*NAIVE, "chronos") else "perfect"),
        "origins": len(found.errors_K),
        "mae_6h_K": mae_K(found, 6),
        "mae_24h_K": mae_K(found, 24),
        "pinball_K": found.pinball_K,
        "coverage_80": float(found.inside.mean()),
        "ms": found.milliseconds,
    }


def _pooled(scores: dict[str, dict[str, Score]], groups: dict[str, str]) -> dict[str, dict[str, Score]]:
    """Scores pooled over the sources of each group."""
    pooled: dict[str, dict[str, Score]] = {}
    for group in dict.fromkeys(groups.values()):
        members = [scores[source] for source in scores if groups[source] == group]
        pooled[group] = {
            method: Score(
                np.concatenate([m[method].errors_K for m in members]),
                np.concatenate([m[method].inside for m in members]),
                float(np.mean([m[method].pinball_K for m in members])),
                float(np.median([m[method].milliseconds for m in members])),
            )
            for method in members[0]
            if all(method in m for m in members)
        }
    return pooled


def _targets(scores: dict[str, dict[str, Score]], groups: dict[str, str]) -> list[Target]:
    targets = []
    pooled = _pooled(scores, groups)
    for group, by_method in pooled.items():
        best = min(mae_K(by_method[name], 24) for name in NAIVE if name in by_method)
        coverage = float(by_method["chronos"].inside.mean())
        targets += [
            Target(
                f"{group}: chronos 24-h MAE over the best naive method's", mae_K(by_method["chronos"], 24) / best, 0.9
            ),
            Target(f"{group}: coverage of chronos' 80 % interval, low side", coverage, 0.75, "at least"),
            Target(f"{group}: coverage of chronos' 80 % interval, high side", coverage, 0.85),
        ]
        for hours in (6, 24):
            part = min(mae_K(by_method[name], hours) for name in ("chronos", "linear_weather"))
            goal = 0.9 if group in ("BOPTEST", "Mons") else 1.02
            ratio = mae_K(by_method["residual"], hours) / part
            targets.append(Target(f"{group}: residual {hours}-h MAE over the better of its parts", ratio, goal))
    return targets


def _uncertainty_targets(
    scores: dict[str, dict[str, Score]], groups: dict[str, str], uncertain: dict[Level, dict[str, list[Score]]]
) -> list[Target]:
    """Targets: with forecast errors, `residual` is at least as good as the backbone, which uses no weather."""
    blind = [scores[name]["chronos"] for name in scores if groups[name] == "BOPTEST"]
    if not blind:
        return []
    without = float(np.mean([mae_K(found, 24) for found in blind]))
    return [
        Target(
            f"BOPTEST, {level} forecast errors: residual 24-h MAE over chronos'",
            float(np.mean([mae_K(found, 24) for found in by_method["residual"]])) / without,
            1.0,
        )
        for level, by_method in uncertain.items()
    ]


def _plot(scores: dict[str, dict[str, Score]], groups: dict[str, str], out: Path) -> None:
    """Mean absolute error over the lead time, one panel per group."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    pooled = _pooled(scores, groups)
    methods = list(dict.fromkeys(name for by_method in pooled.values() for name in by_method))
    figure, axes = plt.subplots(1, len(pooled), figsize=(4.2 * len(pooled), 3.6), squeeze=False, layout="constrained")
    for axis, (group, by_method) in zip(axes[0], pooled.items(), strict=True):
        for method, found in by_method.items():
            n = found.errors_K.shape[1]
            hours = np.arange(1, n + 1) * DAY_S / HOUR_S / n
            bold = method in ("chronos", "residual")
            axis.plot(
                hours,
                found.errors_K.mean(axis=0),
                label=method,
                lw=2.2 if bold else 1.0,
                color=f"C{methods.index(method)}",
            )
        axis.set(title=group, xlabel="lead time, h", ylabel="mean absolute error, K", ylim=(0, None))
    handles = {label: line for axis in axes[0] for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(list(handles.values()), list(handles), loc="outside right upper", fontsize=7)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "free_response.png", dpi=130)
    plt.close(figure)
