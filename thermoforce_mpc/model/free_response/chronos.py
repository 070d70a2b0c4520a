"""Free response by a frozen time-series foundation model on the control-free series T − F (paper eq:compose)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.data.series import short_gaps_bridged
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.execution.cooperative import Computation, Request, perform, run
from thermoforce_mpc.model.free_response.backbones.base import Context, clock, frozen_pass
from thermoforce_mpc.model.free_response.backbones.loading import SHIPPED, load_backbone, shipped_folder
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free
from thermoforce_mpc.model.free_response.linear_weather import (
    DISTURBANCES_H,
    Persistence,
    fits_linear_weather,
    mean_course,
)
from thermoforce_mpc.model.free_response.multi_resolution import (
    FEWEST_VALUES,
    Resolution,
    merged,
    resolutions_of,
)
from thermoforce_mpc.scenario.settings import suggestion

if TYPE_CHECKING:
    from torch import nn

__all__ = ["SHIPPED", "ChronosFreeResponse", "shipped_folder"]

# Longest time between two known values that a line bridges. With a tenth of the hourly values lost, the shipped Bolt
# errs by 38 % more over 6 h and `residual` by 15 %, with lines by 2 % and 0 (tf-mpc bench free-response, embedded and
# BOPTEST records, 2026-11-28). Lines over 12 h do no better, and make intervals too narrow with the machine off.
_BRIDGED_S = 6 * HOUR_S
# With less than a day of measurements persistence is used, and the note says so.
_SHORTEST_HISTORY_S = DAY_S
# Values that a backbone's first patch takes: half of one would be padding.
_SHORTEST_CONTEXT = 16
_RESOLUTIONS = ("several", "one")

Task = tuple[Array, Record, Boundary]


@dataclass(frozen=True)
class _Input:
    """What a backbone is given for a task, and what is added to its answer, `ahead_C` (N,) °C."""

    resolutions: list[Resolution]
    ahead_C: Array


class ChronosFreeResponse:
    """`FreeResponse` by a frozen backbone: evaluation mode, no gradients, weights hashed on request."""

    name = "chronos"

    def __init__(
        self,
        backbone: str = SHIPPED,
        context_steps: int = 512,
        resolutions: str = "several",
        *,
        after_linear_weather: bool = False,
    ) -> None:
        """Load the weights.

        `backbone`: see `load_backbone`. `context_steps`: largest number of history values per resolution.
        `resolutions`: 'several', see `multi_resolution`, or 'one' at the series' own step, unrolled as in the paper.
        `after_linear_weather`: forecast what linear weather models leave over instead of the series itself, as a
        backbone that was trained for that does anyhow. Raises `ConfigError`, and `BackboneError` as `load_backbone`.
        """
        if context_steps < _SHORTEST_CONTEXT:
            raise ConfigError(
                f"context_steps is {context_steps}: backbones read patches of {_SHORTEST_CONTEXT}, give at least that"
            )
        if resolutions not in _RESOLUTIONS:
            raise ConfigError(
                f"resolutions is '{resolutions}'{suggestion(str(resolutions), _RESOLUTIONS)}: "
                f"choose one of {', '.join(_RESOLUTIONS)}"
            )
        self.backbone, self._resolutions = backbone, resolutions
        self._context_steps = context_steps
        self.model = load_backbone(backbone)
        # One that was trained on what linear weather models leave over reads their course, too.
        self._reads_course = bool(getattr(self.model, "after_linear_weather", False))
        self._after_linear_weather = after_linear_weather or self._reads_course
        if after_linear_weather:
            self.name = "residual"

    @property
    def label(self) -> str:
        """Name for reports."""
        return self.model.label

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """Modules with weights."""
        return self.model.modules

    def weight_hash(self) -> str:
        """Return the SHA-256 of all weights, of their file where a graph holds them; they are frozen."""
        graph = getattr(self.model, "graph", None)
        if graph is not None:
            return str(graph.weights_sha256)
        digest = hashlib.sha256()
        for index, module in enumerate(self.model.modules):
            for name, tensor in sorted(module.state_dict().items()):
                digest.update(f"{index}.{name}{tuple(tensor.shape)}".encode())
                digest.update(tensor.detach().cpu().contiguous().float().numpy().tobytes())
        return digest.hexdigest()

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`. A line bridges gaps of up to 2 h; the model is told of longer ones.

        Raises `DataError` where no value was measured, history and forecast differ in step, the model's output is not
        finite, or the weather is not and a linear weather model is corrected.
        """
        return self.forecast_many([(free_C, history, boundary)])[0]

    def forecast_many(self, tasks: Sequence[Task]) -> list[FreeForecast]:
        """Forecasts for several buildings or instants in one pass; a task is the arguments of `forecast`."""
        return run(self.forecasting(tasks))

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Computation[tuple[FreeForecast, object]]:
        """See `ComputedFreeResponse.following`; raises what `forecast` raises."""
        (forecast,) = yield from self.forecasting([(free_C, history, boundary)])
        return forecast, None

    def forecasting(self, tasks: Sequence[Task]) -> Computation[list[FreeForecast]]:
        """`forecast_many` as a computation: it requests the quantiles of all its contexts from the backbone."""
        inputs = [self._input_of(*task) for task in tasks]
        contexts = [
            resolution.context
            for of_task in inputs
            if not isinstance(of_task, FreeForecast)
            for resolution in of_task.resolutions
        ]
        per_context: Iterator[Array] = iter(())
        if contexts:
            per_context = iter((yield from perform(Request(self.model, self._run_backbone, contexts))))
        answers = []
        for of_task, (_, _, boundary) in zip(inputs, tasks, strict=True):
            if isinstance(of_task, FreeForecast):
                answers.append(of_task)
                continue
            quantiles = merged(of_task.resolutions, [next(per_context) for _ in of_task.resolutions])
            answers.append(self._checked(np.sort(quantiles, axis=0) + of_task.ahead_C, boundary))
        return answers

    def _run_backbone(self, contexts: Sequence[Context]) -> list[Array]:
        with frozen_pass():
            return self.model.quantiles_C(contexts)

    def _input_of(self, free_C: Array, history: Record, boundary: Boundary) -> _Input | FreeForecast:
        """What the backbone is given for a task, or the forecast of persistence where it is too little."""
        free = checked_free(free_C, history)
        if history.n_steps and abs(history.step_s - boundary.step_s) > 1e-6:
            raise DataError(f"history at {history.step_s:g} s and forecast at {boundary.step_s:g} s differ in step")
        apart = int((_BRIDGED_S + 1e-6) // boundary.step_s)
        why = self._too_little(short_gaps_bridged(free, apart), boundary.step_s)
        if why:
            return replace(Persistence().forecast(free, history, boundary), note=f"persistence: {why}")
        past, ahead = _known_of(history), _known_of(boundary)[1:]
        resolutions = partial(
            resolutions_of, step_s=boundary.step_s, longest=self._context_steps, hourly=self._resolutions == "several"
        )
        if not self._after_linear_weather:
            return _Input(resolutions(short_gaps_bridged(free, apart), past, ahead), np.zeros(boundary.n_steps))
        course = mean_course(fits_linear_weather(free, history, boundary, DISTURBANCES_H))
        past_C, ahead_C = course[: free.size], course[free.size :]
        if self._reads_course:
            past, ahead = np.column_stack([past, past_C]), np.column_stack([ahead, ahead_C])
        return _Input(resolutions(short_gaps_bridged(free - past_C, apart), past, ahead), ahead_C)

    def _too_little(self, free: Array, step_s: float) -> str:
        context = free[-self._context_steps :]
        n_measured, n_recent = int(np.isfinite(free).sum()), int(np.isfinite(context).sum())
        # A day has one boundary more than steps.
        if n_measured < round(_SHORTEST_HISTORY_S / step_s) + 1:
            return f"only {(n_measured - 1) * step_s / HOUR_S:g} h of history measured"
        if n_recent < FEWEST_VALUES:
            return f"only {n_recent} of the last {context.size} values were measured"
        return ""

    def _checked(self, quantiles: Array, boundary: Boundary) -> FreeForecast:
        if quantiles.shape != (LEVELS.size, boundary.n_steps) or not np.isfinite(quantiles).all():
            raise DataError(f"{self.label} gave values of shape {quantiles.shape} that are not all finite")
        note = f"linear weather model, corrected by {self.label}" if self._after_linear_weather else self.label
        return FreeForecast(LEVELS, quantiles, note)


def _known_of(of: Record | Boundary) -> Array:
    """What a backbone may know of each instant beside the series, see `Context`, (k, 3)."""
    return np.stack([of.T_out_C, of.solar_W_m2, clock(of.time_s)], axis=1)
