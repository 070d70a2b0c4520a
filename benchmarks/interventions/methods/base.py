"""Interface of the compared methods (training data, prediction), and selection among settings on validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.interventions.dataset import Probe, Window
from thermoforce_mpc.data import ACTING, SAMPLED, Array, Record
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.plants.energyplus.zone import Climate

# Smallest true effect whose sign is scored, K.
LEAST_EFFECT_K = 0.05
# Candidates within this factor of the lowest effect RMSE count as equal: over 36 windows its error is 1/√72, 12 %.
_LEVEL = 1.1


@dataclass(frozen=True)
class Training:
    """Training data of a method: K probe days, and validation windows for the choice of settings.

    Attributes:
        climate: sign of the actuator, step and zone.
        days: number of probe days K.
        probe: history and pair of runs (probed, plain operation).
        validation: windows for the choice of settings, not for fitting.
        seed: seed of random numbers.
    """

    climate: Climate
    days: int
    probe: Probe
    validation: Sequence[Window]
    seed: int = 1

    def runs(self) -> tuple[Record, Record]:
        """Both runs of the probe days, each preceded by the common history (context of the forecasters)."""
        return joined(self.probe.history, self.probe.pair.a), joined(self.probe.history, self.probe.pair.b)


class Predictor(Protocol):
    """A fitted method."""

    @property
    def note(self) -> str:
        """Fitted or chosen settings, for the table."""
        ...

    def respond(self, window: Window, u: Array) -> Array:
        """Zone temperature at the end of each of the N steps under each plan `u` (M, N), shape (M, N), °C.

        Only `window.history` and `window.boundary` may be used.
        """
        ...


P = TypeVar("P", bound=Predictor)


def joined(first: Record, second: Record) -> Record:
    """Concatenation of two records, of which the second begins where the first ends."""
    return Record(
        **{n: np.concatenate([getattr(first, n)[..., :-1], getattr(second, n)], axis=-1) for n in SAMPLED},
        **{n: np.concatenate([getattr(first, n), getattr(second, n)], axis=-1) for n in ACTING},
        names=second.names,
    )


def plans(window: Window) -> Array:
    """The control of both runs of a window, shape (2, N): factual, perturbed."""
    return np.stack([window.factual.u[0], window.perturbed.u[0]])


def true_effect(window: Window) -> Array:
    """True effect of the shift at the end of each step (paper eq:effect), shape (N,), K."""
    return np.asarray(window.perturbed.T_zone_C[0, 1:] - window.factual.T_zone_C[0, 1:])


def predicted_effect(predictor: Predictor, window: Window) -> Array:
    """Predicted effect of the shift, shape (N,), K."""
    answer = predictor.respond(window, plans(window))
    return np.asarray(answer[1] - answer[0])


def effect_rmse(predictor: Predictor, windows: Sequence[Window]) -> float:
    """RMSE of the effect over all steps of all windows, K."""
    return rms([predicted_effect(predictor, w) - true_effect(w) for w in windows])


def factual_rmse(predictor: Predictor, windows: Sequence[Window]) -> float:
    """RMSE of the temperature under the applied control, K."""
    return rms([predictor.respond(w, w.factual.u)[0] - w.factual.T_zone_C[0, 1:] for w in windows])


def sign_accuracy(predictor: Predictor, windows: Sequence[Window]) -> float:
    """Share of steps with the right sign of the effect, where it exceeds `LEAST_EFFECT_K`; 1 if there are none."""
    right = [signs_right(predicted_effect(predictor, w), true_effect(w)) for w in windows]
    signs = np.concatenate(right)
    return float(np.mean(signs)) if signs.size else 1.0


def signs_right(predicted: Array, truth: Array) -> NDArray[np.bool_]:
    """Whether the predicted sign is right, for each step whose true effect exceeds `LEAST_EFFECT_K`."""
    clear = np.abs(truth) > LEAST_EFFECT_K
    return np.asarray(np.sign(predicted[clear]) == np.sign(truth[clear]))


def best(candidates: Mapping[str, P], windows: Sequence[Window], *, factual: bool = False) -> str:
    """Name of the best candidate on `windows`; the first one of a tie.

    It is the candidate with the highest sign accuracy among those within 10 % of the lowest effect RMSE, a difference
    that a few dozen windows cannot resolve. With `factual` it is the one with the lowest factual RMSE.
    """
    score = factual_rmse if factual else effect_rmse
    # A diverged candidate scores infinity, since NaN would break the comparison.
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
    """Whether `one` has an effect RMSE more than 9 % below that of `other` and no lower sign accuracy on `windows`."""
    lower = _LEVEL * effect_rmse(one, windows) < effect_rmse(other, windows)
    return lower and sign_accuracy(one, windows) >= sign_accuracy(other, windows)
