"""What a method is given, what it answers, and how a choice among its settings is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from thermoforce_mpc.interventions.dataset import Probe, Window
from thermoforce_mpc.interventions.protocol import Climate
from thermoforce_mpc.types import Array, History


@dataclass(frozen=True)
class Training:
    """Everything a method may learn from: K probe days, and the validation windows for choices among settings.

    Attributes:
        climate: sign, step and zone.
        days: K.
        probe: history, plain operation and probed run.
        validation: windows to choose by; never to fit to.
        seed: of whatever is drawn.
    """

    climate: Climate
    days: int
    probe: Probe
    validation: Sequence[Window]
    seed: int = 1

    def runs(self) -> tuple[History, History]:
        """Both runs of the probe days, each behind the history they share (so that forecasters have a context)."""
        return joined(self.probe.history, self.probe.pair.a), joined(self.probe.history, self.probe.pair.b)


class Predictor(Protocol):
    """A fitted method."""

    @property
    def note(self) -> str:
        """What was fitted or chosen, for the table's footnote."""
        ...

    def respond(self, window: Window, u: Array) -> Array:
        """Zone temperature at the end of each of the N steps under each plan `u` (M, N), shape (M, N), °C.

        Of `window` only the history and the boundary may be used.
        """
        ...


def joined(first: History, second: History) -> History:
    """Two records of which the second begins where the first ends."""
    sampled = {
        name: np.concatenate([getattr(first, name)[:-1], getattr(second, name)])
        for name in ("time_s", "T_zone_C", "T_out_C", "solar_W_m2")
    }
    acting = {
        name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in ("u", "power_W", "heat_W")
    }
    return History(**sampled, **acting)


def plans(window: Window) -> Array:
    """The control of both runs of a window, shape (2, N): factual, perturbed."""
    return np.stack([window.factual.u, window.perturbed.u])


def true_effect(window: Window) -> Array:
    """What the shift really changed at the end of each step (paper eq:effect), shape (N,), K."""
    return np.asarray(window.perturbed.T_zone_C[1:] - window.factual.T_zone_C[1:])


def predicted_effect(predictor: Predictor, window: Window) -> Array:
    """What the method says it changed, shape (N,), K."""
    answer = predictor.respond(window, plans(window))
    return np.asarray(answer[1] - answer[0])


def effect_rmse(predictor: Predictor, windows: Sequence[Window]) -> float:
    """RMSE of the effect over all steps of all windows, K."""
    errors = [predicted_effect(predictor, w) - true_effect(w) for w in windows]
    return float(np.sqrt(np.mean(np.square(errors))))


def factual_rmse(predictor: Predictor, windows: Sequence[Window]) -> float:
    """RMSE of the temperature under the control that was applied, K."""
    errors = [predictor.respond(w, w.factual.u[None])[0] - w.factual.T_zone_C[1:] for w in windows]
    return float(np.sqrt(np.mean(np.square(errors))))


def best(candidates: Mapping[str, Predictor], windows: Sequence[Window], *, factual: bool = False) -> str:
    """Name of the candidate with the least effect RMSE (or factual RMSE) on `windows`; the first of equals."""
    score = factual_rmse if factual else effect_rmse
    # A diverged candidate scores infinity instead of poisoning the comparison.
    scores = {name: np.nan_to_num(score(p, windows), nan=np.inf, posinf=np.inf) for name, p in candidates.items()}
    return min(scores, key=lambda name: float(scores[name]))
