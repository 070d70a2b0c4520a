"""The paper's tables: which figure of a bench stands beside which printed one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.interventions.methods.registry import METHODS
from benchmarks.paper.printed import BACKBONES, CLOSED_LOOP, COVARIATES, FACTUAL, INTERVENTIONAL_VALIDITY
from thermoforce_mpc.plants.energyplus.zone import CLIMATES

# The rows of a table: name → quantity → (printed in the paper, measured here, the measurement with each seed); None
# where there is none, and no seeds where there is one.
Pair = tuple[float | None, float | None] | tuple[float | None, float, tuple[float, ...]]
Rows = dict[str, dict[str, Pair]]
Result = Mapping[str, Any]

# Our backbones beside the paper's: the three scales of each, smallest first.
_SCALES = {"chronos-bolt-tiny": "shipped_tiny", "chronos-bolt-mini": "shipped_small", "chronos-bolt-small": "shipped"}


def interventions(result: Result) -> Rows:
    """Interventional validity: factual and effect RMSE, and share of right signs, per climate and method."""
    printed = {
        (CLIMATES[climate].label, METHODS[name].label): values  # type: ignore[index]
        for (name, climate), values in INTERVENTIONAL_VALIDITY.items()
    }
    rows: Rows = {}
    for row in _with(result, "mode"):
        factual, effect, sign = printed.get((row["mode"], row["method"]), (None, None, None))
        rows[f"{row['mode']}: {row['method']}"] = {
            "factual RMSE, K": (factual, row["factual_K"]),
            "effect RMSE, K": (effect, row["effect_K"]),
            "sign accuracy": (sign, row["sign"]),
        }
    return rows


def factual(result: Result) -> Rows:
    """Few-shot forecasts of measured homes."""
    return {row["method"]: _horizons(FACTUAL.get(row["method"]), row) for row in _with(result, "method")}


def covariates(result: Result) -> Rows:
    """Forecasters that are given control and weather, beside ThermoForce."""
    found = {row["method"]: row for row in _with(result, "method")}
    return {method: _horizons(printed, found[method]) for method, printed in COVARIATES.items()}


def backbones(result: Result) -> Rows:
    """Scales of the frozen forecaster."""
    found = {row["backbone"]: row for row in _with(result, "backbone")}
    rows: Rows = {}
    for name, (millions, raw_K, ours_K) in BACKBONES.items():
        row = found[_SCALES[name]]
        rows[f"{name}; here {_SCALES[name]}"] = {
            "parameters, millions": (millions, row["parameters"] / 1e6),
            "raw RMSE 6 h, K": (raw_K, row["raw_K"]),
            "ThermoForce RMSE 6 h, K": (ours_K, row["thermoforce_K"]),
            "change, %": (100.0 * (ours_K / raw_K - 1.0), row["change_percent"]),
        }
    return rows


def closed_loop(result: Result) -> Rows:
    """Energy, discomfort and cost of two weeks, over seeds, what they change against native control, and the tests."""
    measured: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    tests: Rows = {}
    for row in result["rows"]:
        if "p" in row:
            tests[row["test"]] = {"p": (None, row["p"]), "lower in": (None, row["lower"]), "of": (None, row["of"])}
        else:
            measured.setdefault((row["window"], row["controller"]), []).append(row)
    rows: Rows = {}
    for (window, name), seeds in measured.items():
        printed, native = CLOSED_LOOP.get((window, name)), CLOSED_LOOP[window, "native"]
        reference = measured[window, "native"][0]
        cells: dict[str, Pair] = {}
        for i, (key, words) in enumerate(_KPIS.items()):
            cells[words] = over_seeds(printed and printed[i], [row[key] for row in seeds])
        if name != "native":
            for i, (key, words) in enumerate(list(_KPIS.items())[:2]):
                cells[f"{words.split(',')[0]} against native, %"] = over_seeds(
                    printed and _percent(printed[i], native[i]), [_percent(row[key], reference[key]) for row in seeds]
                )
        rows[f"{window}: {name}"] = cells
    return rows | tests


# Columns of the closed loop's rows, and their words.
_KPIS = {
    "energy_kWh_m2": "energy, kWh/m²",
    "discomfort_Kh": "discomfort, K·h",
    "cost_EUR_m2": "cost, EUR/m²",
}


def over_seeds(printed: float | None, values: Sequence[float]) -> Pair:
    """A figure of the paper beside the mean over seeds; each of them, where there are several."""
    mean = sum(values) / len(values)
    return (printed, mean) if len(values) == 1 else (printed, mean, tuple(values))


def ablation(result: Result) -> Rows:
    """Linear and neural gain, by days of probing: mean of the climates."""
    rows: Rows = {}
    for days in sorted({row["days"] for row in result["rows"]}):
        cells: dict[str, Pair] = {}
        for gain in ("linear", "neural"):
            of = [row for row in result["rows"] if row["days"] == days and row["gain"] == gain]
            for key in ("DR_down_K", "DR_up_K"):
                here = sum(row[key] for row in of) / len(of)
                cells[f"{gain}, {key[:-2].replace('_', '-')}, K"] = (of[0][f"paper_{key}"], here)
        rows[f"{days} probe days"] = cells
    return rows


def gamma(result: Result) -> Rows:
    """The coefficient of the modulation; the paper prints a curve without figures."""
    rows: Rows = {}
    for row in result["rows"]:
        rows.setdefault(f"γ = {row['gamma']:g}", {})[f"{row['mode']}, effect RMSE, K"] = (None, row["effect_K"])
    return rows


def efficiency(result: Result) -> Rows:
    """Computing time and trained parameters."""
    return {
        row["component"] + (", ms" if row["unit"] == "ms" else ""): {"figure": (row["paper"], row["here"])}
        for row in result["rows"]
    }


def _with(result: Result, key: str) -> Iterator[dict[str, Any]]:
    """Rows of the first table of a bench that has this column first."""
    return (row for row in result["rows"] if next(iter(row)) == key)


def _horizons(printed: tuple[float, float] | None, row: Mapping[str, Any]) -> dict[str, Pair]:
    at = printed or (None, None)
    return {"RMSE 6 h, K": (at[0], row["rmse_6h_K"]), "RMSE 24 h, K": (at[1], row["rmse_24h_K"])}


def _percent(value: float, than: float) -> float:
    return 100.0 * (value / than - 1.0)
