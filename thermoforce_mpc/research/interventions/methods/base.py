"""What a method is given, what it answers, and how a choice among its settings is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import ACTING, SAMPLED, Array, Record
from thermoforce_mpc.plants.energyplus.climates import Climate
from thermoforce_mpc.research.interventions.dataset import Probe, Window

# Below this a true effect has no sign worth scoring, K.
LEAST_EFFECT_K = 0.05
# Effect RMSE up to this factor above another's is level with it: of 36 windows it is known to 1/√72, some 12 %.
_LEVEL = 1.1


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

    def runs(self) -> tuple[Record, Record]:
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


P = TypeVar("P", bound=Predictor)


def joined(first: Record, second: Record) -> Record:
    """Two records of which the second begins where the first ends."""
    sampled = {name: np.concatenate([getattr(first, name)[:-1], getattr(second, name)]) for name in SAMPLED}
    acting = {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in ACTING}
    return Record(**sampled, **acting)


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


def sign_accuracy(predictor: Predictor, windows: Sequence[Window]) -> float:
    """Share of the steps with an effect beyond `LEAST_EFFECT_K` whose predicted effect has its sign; 1 without any."""
    right = [signs_right(predicted_effect(predictor, w), true_effect(w)) for w in windows]
    signs = np.concatenate(right)
    return float(np.mean(signs)) if signs.size else 1.0


def signs_right(predicted: Array, truth: Array) -> NDArray[np.bool_]:
    """Whether the sign is right, for each step whose true effect is beyond `LEAST_EFFECT_K`."""
    clear = np.abs(truth) > LEAST_EFFECT_K
    return np.asarray(np.sign(predicted[clear]) == np.sign(truth[clear]))


def best(candidates: Mapping[str, P], windows: Sequence[Window], *, factual: bool = False) -> str:
    """Name of the best candidate on `windows`; the first of equals.

    The best has the least effect RMSE; among those within 10 % of it, which some dozen windows cannot tell apart, it is
    the one with the most signs right. Where `factual`, it is the least factual RMSE.
    """
    score = factual_rmse if factual else effect_rmse
    # A diverged candidate scores infinity instead of poisoning the comparison.
    scores = {
        name: float(np.nan_to_num(score(p, windows), nan=np.inf, posinf=np.inf)) for name, p in candidates.items()
    }
    least = min(scores, key=lambda name: scores[name])
    if factual:
        return least
    level = {name: p for name, p in candidates.items() if scores[name] <= _LEVEL * scores[least]}
    signs = {name: sign_accuracy(p, windows) for name, p in level.items()}
    return max(level, key=lambda name: (signs[name], -scores[name]), default=least)


def clearly_better(one: Predictor, other: Predictor, windows: Sequence[Window]) -> bool:
    """Whether `one` has an effect RMSE more than 9 % lower than `other`, and no more signs wrong, on `windows`."""
    lower = _LEVEL * effect_rmse(one, windows) < effect_rmse(other, windows)
    return lower and sign_accuracy(one, windows) >= sign_accuracy(other, windows)
