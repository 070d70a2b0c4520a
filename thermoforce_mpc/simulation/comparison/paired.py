"""Differences between two controllers window by window, and how sure their mean is.

Windows differ far more than controllers do, so controllers are compared on the same windows. The interval is that of
Student's t over windows, taken as draws of one kind: with two or three of them it is wide, and of one there is none.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.simulation.comparison.outcome import COST, DISCOMFORT, Row
from thermoforce_mpc.simulation.comparison.store import DONE

# Probability with which an interval holds the mean.
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Difference:
    """Differences of n windows, their mean, and the half width of its interval; None of one window."""

    values: Array
    mean: float
    half: float | None

    @classmethod
    def of(cls, values: Array) -> Difference:
        """The differences `values` (n,) of n ≥ 1 windows."""
        n = values.size
        half = None
        if n > 1:
            from scipy.special import stdtrit  # takes time to import, which `--help` need not wait for

            spread = float(values.std(ddof=1)) / np.sqrt(n)
            half = float(stdtrit(n - 1, 0.5 + CONFIDENCE / 2)) * spread
        return cls(values, float(values.mean()), half)


@dataclass(frozen=True)
class Pair:
    """A controller and a reference under one tariff and forecast error level, on the windows that both finished.

    `cost_percent`: difference of cost, % of the reference's; `discomfort_Kh`: difference of discomfort, K·h.
    """

    controller: str
    reference: str
    price: str
    uncertainty: str
    windows: tuple[str, ...]
    cost_percent: Difference
    discomfort_Kh: Difference


def reference_of(rows: Iterable[Row]) -> str | None:
    """The controller to compare with: the thermostat, else the cheapest without a model, else the first."""
    finished = [row for row in rows if row["status"] == DONE]
    without = [row for row in finished if not row["needs_model"]]
    if any(row["controller"] == "thermostat" for row in without):
        return "thermostat"
    cheapest = min(without, key=lambda row: float(row[COST]), default=None) or next(iter(finished), None)
    return None if cheapest is None else str(cheapest["controller"])


def pairs(rows: Iterable[Row], reference: str) -> list[Pair]:
    """Every controller beside `reference`, by tariff and forecast error level, in the order of the rows."""
    finished = [row for row in rows if row["status"] == DONE]
    compared = []
    for price, uncertainty in dict.fromkeys((row["price"], row["uncertainty"]) for row in finished):
        by_controller: dict[str, dict[str, Row]] = {}
        for row in finished:
            if (row["price"], row["uncertainty"]) == (price, uncertainty):
                by_controller.setdefault(row["controller"], {})[row["window"]] = row
        beside = by_controller.get(reference, {})
        for controller, of in by_controller.items():
            # Without a cost there is no share of it.
            windows = tuple(window for window in of if window in beside and beside[window][COST] > 0)
            if controller == reference or not windows:
                continue
            cost = [100.0 * (of[w][COST] / beside[w][COST] - 1.0) for w in windows]
            discomfort = [of[w][DISCOMFORT] - beside[w][DISCOMFORT] for w in windows]
            compared.append(
                Pair(
                    controller,
                    reference,
                    price,
                    uncertainty,
                    windows,
                    Difference.of(np.array(cost)),
                    Difference.of(np.array(discomfort)),
                )
            )
    return compared


def in_words(difference: Difference, digits: int) -> str:
    """'−3.1 (−4.0 to −2.2)'."""
    mean = f"{difference.mean:+.{digits}f}"
    if difference.half is None:
        return mean
    low, high = difference.mean - difference.half, difference.mean + difference.half
    return f"{mean} ({low:+.{digits}f} to {high:+.{digits}f})"
