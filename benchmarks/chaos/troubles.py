"""What goes wrong in an episode: drawn from a seed, each between two instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S

# Single requests, with the endpoints they are drawn for ("" is any).
REFUSALS = ("500", "500 after", "502", "503", "504", "429", "400")
BROKEN = ("reset before", "reset after", "half answer", "html", "other json", "empty")
NOT_ITSELF = ("redirect", "redirect after", "page", "page after", "null", "null after", "cached")
WRONG_CLOCK = {"clock 900 s ahead": 900.0, "clock 900 s behind": -900.0, "clock 0.5 s ahead": 0.5,
               "clock 0.5 s behind": -0.5, "forecast 1 h ahead": 3600.0}  # fmt: skip
TWICE = ("doubled", "late")
SILENT = ("silent before", "silent after")
READINGS = ("missing point", "nan", "stuck", "in °C")
# From the start on: points whose names begin so, times a factor; and the words in which a run must say it.
UNITS = {
    "prices x 100": ("PriceElectricPower", 100.0, "prices of"),
    "power in kW": ("reaP", 1e-3, "power_W"),
    "heat in kW": ("reaQ", 1e-3, "heat_W"),
}
# A solver that claims levels out of range or of another shape, a forecast that no room can have.
INSIDE = (
    *(f"{who} {what}" for who in ("solver", "forecaster") for what in ("raises", "nan", "hangs")),
    "solver out of range",
    "solver of another shape",
    "forecaster absurd",
)
AWAY = ("refusing", "unavailable")
NO_FORECAST = "no forecast"
RESTART = "restarted"
CLASSES: dict[str, tuple[str, ...]] = {
    "refused": REFUSALS, "broken": BROKEN, "not itself": NOT_ITSELF, "wrong clock": tuple(WRONG_CLOCK), "twice": TWICE,
    "silent": SILENT, "readings": READINGS, "inside": INSIDE, "away": AWAY, "no forecast": (NO_FORECAST,),
    "restarted": (RESTART,), "units": tuple(UNITS),
}  # fmt: skip
_WEIGHTS = np.array([4, 4, 4, 4, 2, 1, 4, 4, 3, 1, 0.5, 3])

# Kinds that cost real time: at most this many requests in an episode.
_MOST_SLOW = 2
_LONGEST_AWAY_S = 14.0 * 60.0


@dataclass(frozen=True)
class Trouble:
    """One kind of fault from `from_s` to `to_s` after the start of the window, s.

    `at`: endpoint, "" for any; `share`: of its requests; `most`: requests at most; `seconds`: how long a service is
    away, or something hangs, s.
    """

    kind: str
    from_s: float
    to_s: float
    at: str = ""
    share: float = 1.0
    most: int = 10**9
    seconds: float = 0.0

    def in_words(self) -> str:
        """For the table: kind, endpoint and hours."""
        at = f" at {self.at}" if self.at else ""
        away = f" for {self.seconds / 60:.0f} min" if self.kind in AWAY else ""
        return f"{self.kind}{at}{away} ({self.from_s / HOUR_S:.0f} to {self.to_s / HOUR_S:.0f} h)"


def drawn(rng: np.random.Generator, days: float) -> tuple[Trouble, ...]:
    """One to three troubles of an episode; a service that forgets its tests comes last and alone of its kind."""
    groups = list(CLASSES.values())
    chosen = rng.choice(len(groups), size=int(rng.integers(1, 4)), replace=False, p=_WEIGHTS / _WEIGHTS.sum())
    return tuple(_drawn(rng, str(rng.choice(groups[i])), days * DAY_S) for i in sorted(chosen))


def _drawn(rng: np.random.Generator, kind: str, length_s: float) -> Trouble:
    if kind in UNITS:
        return Trouble(kind, 0.0, length_s)
    from_s = float(rng.uniform(0.0, 0.8)) * length_s
    if kind == RESTART:
        return Trouble(kind, from_s, length_s, most=1)
    if kind in AWAY:
        return Trouble(kind, from_s, length_s, most=1, seconds=float(rng.uniform(5.0, _LONGEST_AWAY_S)))
    hours = float(rng.choice([1.0, 3.0, 6.0]))
    to_s = min(from_s + hours * HOUR_S, length_s)
    if kind in INSIDE:
        slow = kind.endswith("hangs")
        return Trouble(kind, from_s, to_s, most=_MOST_SLOW if slow else 10**9, seconds=1.0)
    if kind == NO_FORECAST:  # for good, or for a while
        return Trouble(kind, from_s, length_s if rng.random() < 0.5 else to_s, at="forecast")
    if kind in READINGS:
        return Trouble(kind, from_s, to_s, at="advance")
    if kind in SILENT or kind == "late":
        return Trouble(kind, from_s, length_s, at=_endpoint(rng, kind), share=0.2, most=_MOST_SLOW)
    return Trouble(kind, from_s, to_s, at=_endpoint(rng, kind), share=float(rng.choice([0.05, 0.3, 0.7])))


def _endpoint(rng: np.random.Generator, kind: str) -> str:
    if kind in TWICE:
        return "advance"
    if kind.startswith("forecast"):
        return "forecast"
    return str(rng.choice(["", "advance", "forecast", "results"], p=[0.4, 0.3, 0.15, 0.15]))
