"""Tables of the suite: main, covariates, few-shot, backbones, homes; and the targets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from benchmarks.factual.evaluate import (
    BEST,
    COVARIATES,
    COVARIATES_AR,
    METHODS,
    OURS,
    PERSISTENCE,
    RAW,
    RC_FULL,
    RESIDUAL,
    Scores,
)
from benchmarks.factual.protocol import Protocol
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.data import Array

Row = dict[str, Any]

_MEDIAN_GOALS = {"6": 0.90, "24": 1.00}
_SHARE_AHEAD, _WORST = 7 / 9, 1.05


def errors_of(scores: Sequence[Scores], method: str, days: int, hours: str) -> Array:
    """Test RMSE of each home, K (homes,); NaN where the method was not scored."""
    key = "0" if method in (PERSISTENCE, RAW) else str(days)
    return np.array([s.errors.get(method, {}).get(key, {}).get(hours, np.nan) for s in scores])


def one_sided(ours: Array, other: Array) -> float:
    """p of the one-sided Wilcoxon signed-rank test that `ours` is lower, over homes that both have; 1 if none."""
    both = np.isfinite(ours) & np.isfinite(other)
    if not (ours[both] != other[both]).any():
        return 1.0
    return float(wilcoxon(ours[both], other[both], alternative="less").pvalue)


def main_rows(scores: Sequence[Scores], protocol: Protocol) -> list[Row]:
    """Paper's table of few-shot factual forecasts: median RMSE, homes ahead of the raw forecaster, p."""
    rows = []
    for method in METHODS:
        row: Row = {"method": method, "days": protocol.main_days}
        for h in _hours(protocol):
            mine, raw = (errors_of(scores, name, protocol.main_days, h) for name in (method, RAW))
            if not np.isfinite(mine).any():
                break
            row[f"rmse_{h}h_K"] = float(np.nanmedian(mine))
            row[f"beats_tsfm_{h}h"] = None if method == RAW else _of(mine < raw, scores)
            row[f"p_{h}h"] = None if method == RAW else one_sided(mine, raw)
        else:
            rows.append(row)
    return rows


def covariate_rows(scores: Sequence[Scores], protocol: Protocol) -> list[Row]:
    """Paper's table of covariate baselines: homes in which ThermoForce is ahead of each."""
    rows = []
    for method in (RAW, COVARIATES, COVARIATES_AR, BEST):
        row: Row = {"covariates": method}
        for h in _hours(protocol):
            mine, best = (errors_of(scores, name, protocol.main_days, h) for name in (method, BEST))
            row[f"rmse_{h}h_K"] = float(np.nanmedian(mine))
            row[f"thermoforce_ahead_{h}h"] = None if method == BEST else _of(best < mine, scores)
        rows.append(row)
    return rows


def few_shot_rows(scores: Sequence[Scores], protocol: Protocol) -> list[Row]:
    """Median RMSE by budget."""
    rows = []
    for method in (RAW, RC_FULL, COVARIATES, OURS, RESIDUAL, BEST):
        for h in _hours(protocol):
            row: Row = {"few-shot": method, "horizon": f"{h} h"}
            row |= {f"{k} d": float(np.nanmedian(errors_of(scores, method, k, h))) for k in protocol.days}
            rows.append(row)
    return rows


def backbone_rows(scores: Sequence[Scores]) -> list[Row]:
    """Paper's table of backbones: median RMSE over the first horizon, raw and composed with the same operator."""
    rows: list[Row] = []
    for name in dict.fromkeys(name for s in scores for name in s.backbones):
        found = [s.backbones[name] for s in scores if name in s.backbones]
        raw, ours = (float(np.median([row[key] for row in found])) for key in ("raw", "ours"))
        rows.append(
            {
                "backbone": Path(name).name,
                "parameters": round(found[0]["parameters"]),
                "raw_K": raw,
                "thermoforce_K": ours,
                "change_percent": 100.0 * (ours / raw - 1.0),
                "lower": f"{sum(row['ours'] < row['raw'] for row in found)} of {len(found)}",
                "higher": f"{sum(row['ours'] > row['raw'] for row in found)} of {len(found)}",
            }
        )
    return rows


def home_rows(scores: Sequence[Scores], protocol: Protocol) -> list[Row]:
    """Each home: raw and best error, their ratio, and what the validation part chose."""
    rows = []
    for s in scores:
        row: Row = {"home": s.home}
        for h in _hours(protocol):
            raw, best = s.errors[RAW]["0"][h], s.errors[BEST][str(protocol.main_days)][h]
            row |= {f"raw_{h}h_K": raw, f"best_{h}h_K": best, f"ratio_{h}h": best / raw}
        row["chosen"] = s.notes[BEST][str(protocol.main_days)]
        row["operator"] = s.notes[OURS][str(protocol.main_days)].split(";")[0]
        rows.append(row)
    return rows


def targets(scores: Sequence[Scores], protocol: Protocol) -> list[Target]:
    """ThermoForce, chosen on validation, over the raw forecaster."""
    out = []
    label = f"{BEST}, {protocol.main_days} d"
    ratios = {
        h: errors_of(scores, BEST, protocol.main_days, h) / errors_of(scores, RAW, protocol.main_days, h)
        for h in _hours(protocol)
    }
    for h, goal in _MEDIAN_GOALS.items():
        if h in ratios:
            out.append(Target(f"{label}: RMSE over raw TSFM, {h} h, median", float(np.median(ratios[h])), goal))
    first = _hours(protocol)[0]
    needed = int(np.ceil(_SHARE_AHEAD * len(scores) - 1e-9))
    ahead = int((ratios[first] < 1.0).sum())
    out.append(Target(f"{label}: homes ahead of raw TSFM, {first} h, of {len(scores)}", ahead, needed, "at least"))
    for h, found in ratios.items():
        who = scores[int(np.argmax(found))].home
        out.append(Target(f"{label}: RMSE over raw TSFM, {h} h, worst ({who})", float(found.max()), _WORST))
    return out


def _hours(protocol: Protocol) -> list[str]:
    return [f"{h:g}" for h in protocol.horizons_h]


def _of(won: NDArray[np.bool_], scores: Sequence[Scores]) -> str:
    return f"{int(won.sum())}/{len(scores)}"
