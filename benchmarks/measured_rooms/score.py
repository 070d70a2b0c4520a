"""A model from the first part of a record, scored on the rest: predictions from many starts, and its step response.

Weather and levels ahead are those measured, so only the model and its free response err. A prediction is the package's
own, free plus forced response; with sun on a zone's sensor, that part of the reading is added again.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Boundary, Layout, Observation, Record
from thermoforce_mpc.data.series import bridged
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import identify
from thermoforce_mpc.identification.probing.operation import telling_part
from thermoforce_mpc.model.free_response.following import follow
from thermoforce_mpc.model.free_response.linear_weather import LinearWeather
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.predictor import Predictor, PredictorState
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse

DEFAULT, RC, WEATHER, PERSISTENCE = "default", "rc", "weather", "persistence"
METHODS = (DEFAULT, RC, WEATHER, PERSISTENCE)
"""The model with the controllers' free response and with its own linear one; the linear weather model on the
temperature itself; the temperature stays."""

SHARE, LEADS_H, EVERY_H, STEP_RESPONSE_H = 0.6, (6, 24), 3.0, 48
"""Share of a record that is identified from, lead times that are scored, distance of the starts, and length of the step
response, h."""


@dataclass(frozen=True)
class RoomScores:
    """Scores of the rooms of one record (Z,).

    `rmse_K[method]`: error at each of `LEADS_H` (Z, 2), K, NaN where none was measured. `starts`: number of them.
    `own_K`: temperature after 48 h at full level of the room's own actuators instead of none, K, and `all_K` of all
    actuators, both in the weather of the record's last 48 h.
    """

    rmse_K: dict[str, Array]
    starts: int
    own_K: Array
    all_K: Array


def split(record: Record) -> int:
    """Number of steps of the part that is identified from."""
    return int(SHARE * record.n_steps)


def identified(record: Record, layout: Layout) -> ThermalModel:
    """The model by default options from the first part of `record`, as `tf-mpc identify --data` makes it.

    Raises:
        DataError: it cannot be fitted.
    """
    part, _ = telling_part(record.slice(0, split(record)), layout)
    return identify(part, layout=layout)


def starts_of(record: Record, every_h: float = EVERY_H) -> list[int]:
    """Steps of the second part after which all levels of the longest lead are known, one in `every_h`."""
    ahead = _steps(record, LEADS_H[-1])
    known: NDArray[np.bool_] = np.asarray(np.isfinite(record.u).all(axis=0))
    every = max(1, _steps(record, every_h))
    return [t for t in range(split(record), record.n_steps - ahead + 1, every) if known[t : t + ahead].all()]


def score(model: ThermalModel, record: Record, every_h: float = EVERY_H) -> RoomScores:
    """Predict from every start and compare with what was measured."""
    leads = [_steps(record, hours) for hours in LEADS_H]
    runs = {
        DEFAULT: _Run(model, [build_free_response("residual", rc=free) for free in model.free]),
        RC: _Run(model, [build_free_response("rc", rc=free) for free in model.free]),
    }
    on_sensors = record.T_zone_C - model.in_rooms(record).T_zone_C
    on_sensors[~np.isfinite(on_sensors)] = 0.0
    weather, _ = bridged(record)
    errors: dict[str, list[Array]] = {method: [] for method in METHODS}
    starts = starts_of(record, every_h)
    for t in starts:
        history, ahead = record.slice(0, t), weather.slice(t, t + leads[-1])
        boundary, at = Boundary.measured(ahead), [t + n for n in leads]
        now = record.T_zone_C[:, [t]]
        truth = np.where(np.isfinite(now), record.T_zone_C[:, at], np.nan)
        for method, run in runs.items():
            predicted = run.predict(history, boundary, record.u[:, t : t + leads[-1]])
            errors[method].append(predicted[:, [n - 1 for n in leads]] + on_sensors[:, at] - truth)
        alone = [follow(LinearWeather(), T, weather.slice(0, t), boundary, None)[0].median_C for T in history.T_zone_C]
        errors[WEATHER].append(np.vstack(alone)[:, [n - 1 for n in leads]] - truth)
        errors[PERSISTENCE].append(now - truth)
    rmse = {method: _rms(np.array(found)) for method, found in errors.items()}
    return RoomScores(rmse, len(starts), *_step_responses(model, record, weather))


def _step_responses(model: ThermalModel, record: Record, weather: Record) -> tuple[Array, Array]:
    """What full level of the room's own and of all actuators changes over the last 48 h of `record`, (Z,) each, K."""
    n = _steps(record, STEP_RESPONSE_H)
    now = record.n_steps - n
    ahead = Boundary.measured(weather.slice(now, now + n))
    history = model.in_rooms(record.slice(0, now))
    context = Predictor(model.operator, LinearWeather()).context(Observation(history, ahead))
    zones, actuators, _ = model.operator.shape
    home = np.asarray(model.operator.home)
    levels = np.concatenate([home == np.arange(zones)[:, None], np.ones((1, actuators), dtype=bool)])
    changed = context.effect(np.repeat(levels[..., None].astype(float), n, axis=-1), np.zeros((actuators, n)))[..., -1]
    return np.diagonal(changed[:-1]).copy(), changed[-1]


def _steps(record: Record, hours: float) -> int:
    return round(hours * HOUR_S / record.step_s)


def _rms(errors: Array) -> Array:
    """RMS over the starts of `errors` (starts, Z, L), where there are any, (Z, L)."""
    if not errors.size:
        raise DataError("no start in the second part of the record has known levels for a day: give a longer record")
    known = np.isfinite(errors).sum(axis=0)
    total = np.nansum(np.square(errors), axis=0)
    return np.where(known > 0, np.sqrt(total / np.maximum(known, 1)), np.nan)


@dataclass
class _Run:
    """Predictions one after the other, each with what was learned before."""

    model: ThermalModel
    free_responses: list[FreeResponse]
    predictor: Predictor = field(init=False)
    state: PredictorState | None = None

    def __post_init__(self) -> None:
        self.predictor = Predictor(self.model.operator, self.free_responses)

    def predict(self, history: Record, boundary: Boundary, u: Array) -> Array:
        """Temperature of the rooms under `u` (A, N), (Z, N), °C."""
        context = self.predictor.context(Observation(self.model.in_rooms(history), boundary), self.state)
        self.state = context.state
        return context.predict(u).total_C
