"""Protocol of the factual suite (paper, sections 'Metrics' and 'Validation-safe selection')."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

DAYS: tuple[int, ...] = (1, 3, 7, 14, 30)
"""Identification budgets K, days."""
MAIN_DAYS = 3
"""Budget of the main and covariate tables and of the targets."""


@dataclass(frozen=True)
class Protocol:
    """How a record is cut and scored.

    Three parts follow each other: fit, validation, test, each a share of the record and at most so many days. A budget
    of K days is the last K days of the fit part. Everything that is chosen is chosen on the validation part; the test
    part is scored once, by what was chosen. The error over a horizon is the RMSE over all its steps, from all origins.

    Attributes:
        days: budgets K.
        horizons_h: forecast horizons, h.
        shares: of fit, validation and test part in a short record.
        most_days: of fit, validation and test part in a long record.
        context_steps: history that the forecaster sees at each origin, steps.
        most_origins, least_origins: of a part.
        guard: share by which an operator must lower the validation error, mean of the horizons, to be used at all.
    """

    days: tuple[int, ...] = DAYS
    horizons_h: tuple[float, ...] = (6.0, 24.0)
    shares: tuple[float, float, float] = (0.4, 0.3, 0.3)
    most_days: tuple[float, float, float] = (30.0, 21.0, 28.0)
    context_steps: int = 512
    most_origins: int = 80
    least_origins: int = 10
    guard: float = 0.02

    @property
    def main_days(self) -> int:
        """Budget of the tables: 3 days, or the one nearest to it."""
        return min(self.days, key=lambda k: abs(k - MAIN_DAYS))

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


QUICK = Protocol(days=(3,), most_origins=25)
