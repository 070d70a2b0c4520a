"""Regression form of runs and pairs: targets, disturbances, and what drives the forced and the free response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.identification.estimation.disturbance import SENSOR_SD_K, Disturbance
from thermoforce_mpc.identification.estimation.records import LEAD_REACH, MOST_ROWS, Pair
from thermoforce_mpc.model.free_response.rc import INPUTS, weather_inputs
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Priors of the free part, steady state, per slow mode: K per K outdoors, K per 100 W/m², K of the daily wave. The total
# gain to the outdoor temperature is near 1; winter sun raises a house by a few K.
FREE_PRIOR: dict[str, tuple[float, float, float, float]] = {
    # name: (unit, mean, standard deviation, lower bound)
    "outdoor": (1.0, 0.3, 0.3, 0.0),
    "solar": (0.01, 1.0, 1.0, 0.0),
    "solar_cosine": (0.01, 0.0, 1.0, -np.inf),
    "solar_sine": (0.01, 0.0, 1.0, -np.inf),
    "daily_cosine": (1.0, 0.0, 0.3, -np.inf),
    "daily_sine": (1.0, 0.0, 0.3, -np.inf),
    "solar_squared": (0.01, 0.0, 1.0, -np.inf),
}
REFERENCE_C = 20.0
# Pairs cancel all drift; the rest is the model error of a few hundredths of a K. It is correlated over about an hour,
# so the standard deviation per row is ten times as large.
_PAIR_SD_K = 0.3
# For the reported uncertainty, disturbances are this many times the fitted residuals (which underestimate them), but at
# least this share of the assumed ones.
_ROOM, _LEAST_DISTURBED = 2.5, 0.1


@dataclass(frozen=True)
class RegressionData:
    """Run or pair in regression form.

    `target` (rows,) K; `rows` (rows,) indices of the boundaries used; `disturbance` of these rows; `inputs` (n, 8)
    weather of the steps, empty for a pair; `drives`: sign and drive v (n,) of each run; `histories`: their records.
    `others` (K, n): drives of the other actuators, signed by their sign, of a pair their difference; `other_gains`
    (K, 2, r): mean and standard deviation of their [slope, G_2 … G_r]. `held`: how
    many of the last rows are held out, so that a fit does not see them.
    """

    target: Array
    rows: NDArray[np.intp]
    disturbance: Disturbance
    step_s: float
    drives: tuple[tuple[int, Array], ...]
    inputs: Array
    histories: tuple[Record, ...] = ()
    others: Array = field(default_factory=lambda: np.empty((0, 0)))
    other_gains: Array = field(default_factory=lambda: np.empty((0, 2, 0)))
    weather_gains: Array | None = None
    held: int = 0

    @property
    def seen(self) -> int:
        """How many of the first rows a fit sees."""
        return self.rows.size - self.held

    def first(self, n: int) -> RegressionData:
        """The first `n` rows, of which none is held out."""
        disturbance = self.disturbance.first(n)
        return replace(self, target=self.target[:n], rows=self.rows[:n], disturbance=disturbance, held=0)

    @property
    def n_steps(self) -> int:
        """Number of steps of the run or pair."""
        return int(self.drives[0][1].size)

    @cached_property
    def drive(self) -> Array:
        """Drive of the run, of a pair the difference of its drives, (n,)."""
        return np.asarray(np.sum([sign * drive for sign, drive in self.drives], axis=0))

    @property
    def weather(self) -> Array:
        """The inputs of `FREE_PRIOR` in their units (7, n)."""
        return np.array([self.inputs[:, INPUTS.index(name)] * unit for name, (unit, *_) in FREE_PRIOR.items()])

    @property
    def is_pair(self) -> bool:
        """Whether this is a difference of two runs, in which the free part cancels."""
        return self.inputs.size == 0


@dataclass(frozen=True)
class OtherActuator:
    """An actuator besides the zone's own: what it delivers, and its sign."""

    heat_input: HeatInput
    sign: int


def run_regression(
    history: Record,
    heat_input: HeatInput,
    others: Sequence[OtherActuator] = (),
    sensor_sd_K: float = SENSOR_SD_K,
) -> RegressionData:
    """Return a run of one zone as a regression; missing temperatures are omitted.

    The first level of `history` is that of the zone's own actuator, the rest are those of `others`.

    The drive is v(u), the heat capacity at the applied level, and not the measured heat that drives the forced history
    of a controlled run (`forced_history.heat_drive`). A plan knows levels only, so the gain is identified per level and
    takes up the mean error of the heat capacity; for the past the measured heat is exact, whoever controlled. The two
    drives differ by the fit error of the heat capacity, which the model card notes (below 1 % of full heat where heat
    was measured on the embedded plant).
    """
    rows = np.arange(0, history.n_steps + 1, _stride(history.n_steps, HOUR_S / history.step_s))
    rows = rows[np.isfinite(history.T_zone_C[0, rows])]
    return RegressionData(
        target=history.T_zone_C[0, rows] - REFERENCE_C,
        rows=rows,
        disturbance=Disturbance.assumed(history.time_s[rows], sensor_sd_K),
        step_s=history.step_s,
        drives=((1, heat_input(history.u[0], history.T_out_C[:-1])),),
        inputs=weather_inputs(history.time_s, history.T_out_C, history.solar_W_m2),
        histories=(history,),
        others=_other_drives(history, others),
    )


def _stride(n_steps: int, hour: float) -> int:
    """Every how many steps a run has a row; `hour`: steps in an hour.

    Rows little less than an hour apart would leave predictions an hour ahead no row to begin from: the last but one is
    out of reach.
    """
    stride, closer = max(1, -(-n_steps // MOST_ROWS)), max(1, int(0.5 * LEAD_REACH * hour))
    return closer if closer < stride < hour else stride


def _other_drives(history: Record, others: Sequence[OtherActuator]) -> Array:
    """Drives of the other actuators, signed (K, n)."""
    rows = [o.sign * o.heat_input(u, history.T_out_C[:-1]) for o, u in zip(others, history.u[1:], strict=True)]
    return np.array(rows).reshape(len(others), history.n_steps)


def pair_regression(pair: Pair, heat_input: HeatInput, others: Sequence[OtherActuator] = ()) -> RegressionData:
    """Return a pair of one zone as a regression of the difference a − b; levels as in `run_regression`."""
    difference = pair.a.T_zone_C[0] - pair.b.T_zone_C[0]
    rows = np.flatnonzero(np.isfinite(difference))
    rows = rows[rows > 0]
    drives = tuple(
        (sign, heat_input(history.u[0], history.T_out_C[:-1])) for sign, history in ((1, pair.a), (-1, pair.b))
    )
    return RegressionData(
        target=difference[rows],
        rows=rows,
        disturbance=Disturbance.independent(pair.a.time_s[rows], _PAIR_SD_K),
        step_s=pair.a.step_s,
        drives=drives,
        inputs=np.empty((0, len(INPUTS))),
        histories=(pair.a, pair.b),
        others=_other_drives(pair.a, others) - _other_drives(pair.b, others),
    )


def calibrated(regressions: Sequence[RegressionData], residual_scale: float) -> list[RegressionData]:
    """Return the regressions with the disturbances of runs scaled to about the size found by the fit.

    Pairs are unchanged: their residual is the model error.
    """
    return scaled(regressions, likely_scale(residual_scale))


def likely_scale(residual_scale: float) -> float:
    """Return the likely size of disturbances as a fraction of the assumed one, from the fit's `residual_scale`."""
    return float(np.clip(_ROOM * residual_scale, _LEAST_DISTURBED, 1.0))


def scaled(regressions: Sequence[RegressionData], scale: float) -> list[RegressionData]:
    """Return the regressions with disturbances of runs times `scale`; pairs are unchanged."""
    return [
        e if e.is_pair or scale == 1.0 else replace(e, disturbance=e.disturbance.scaled(scale)) for e in regressions
    ]
