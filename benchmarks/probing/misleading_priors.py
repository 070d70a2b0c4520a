"""Part of `tf-mpc bench probing`: accuracy and coverage of the uncertainty band with a wrong floor area.

The priors of heat capacity and coupling are per floor area. A floor area that is a quarter too large or too small
shifts both by about one standard deviation in the same direction; the data have to correct this.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.operator.data import ReferencePair
from benchmarks.operator.score import score_pairs
from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.estimation.uncertainty import STEP_RESPONSE_H
from thermoforce_mpc.identification.validation.report import BAND
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.simulation.comparison.results_json import Target

# Given floor areas as shares of the true one.
_TOLD = (1.0, 1.25, 0.8)
_CONFIG = IdentificationConfig(modulation="linear", order=3)
# Lags up to 24 h: the reference pairs last 1.25 days and do not determine longer ones.
_LAGS_H = tuple(h for h in STEP_RESPONSE_H if h <= 24)
_COVERED = 0.8

Row = dict[str, Any]


def run_misleading_priors(
    records: Mapping[int, Sequence[Record]],
    pairs: Sequence[ReferencePair],
    floor_area_m2: float,
    say: Callable[[str], None],
) -> tuple[list[Row], list[Target]]:
    """Identify every record with the true floor area and with wrong ones.

    Args:
        records: probed records by number of days.
        pairs: pairs of runs of the same plant for scoring effects and identifying the true step response.
        floor_area_m2: true floor area, m².
        say: callback for progress lines.
    """
    truth = identify(pairs=[p.pair for p in pairs], config=_CONFIG, floor_area_m2=floor_area_m2)
    rows: list[Row] = []
    targets: list[Target] = []
    for days, given in records.items():
        for share in _TOLD:
            say(f"{days} days, given {100 * share:.0f} % of the floor area")
            errors, inside = [], []
            for record in given:
                try:
                    model = identify([record], config=_CONFIG, floor_area_m2=share * floor_area_m2)
                except DataError:
                    continue
                errors.append(score_pairs(model.only.operator, pairs).rmse_K)
                inside.append(_inside(model, truth))
            covered = float(np.mean(inside))
            rows.append(
                {
                    "part": "priors",
                    "data": f"{days} days, {len(errors)} records",
                    "told_area": f"{100 * share:.0f} %",
                    "mean_rmse_K": float(np.mean(errors)),
                    "worst_rmse_K": float(np.max(errors)),
                    "in_90_band": covered,
                }
            )
        worst = min(row["in_90_band"] for row in rows[-len(_TOLD) :])
        targets.append(Target(f"{days} days: truth inside the 90 % band, worst told area", worst, _COVERED, "at least"))
    return rows, targets


def _inside(model: ThermalModel, truth: ThermalModel) -> Array:
    """Whether the true step response per watt lies in the band, for each lag, shape (lags,), 1.0 or 0.0."""
    known, true = model.only.card.uncertainty, truth.only.card.uncertainty
    # Both are responses to full heat at the reference of the respective model, so they are scaled to equal heat.
    scale = model.only.operator.heat_input.reference_W / truth.only.operator.heat_input.reference_W
    names = [f"step_response_{hours}h" for hours in _LAGS_H]
    return np.array(
        [abs(known[f"{n}_K"] - scale * true[f"{n}_K"]) <= BAND * known[f"{n}_sd_K"] for n in names], dtype=np.float64
    )
