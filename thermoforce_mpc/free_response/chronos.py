"""A frozen time-series foundation model on the control-free series T − F (paper eq:compose), never trained here."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.free_response.backbones.base import Context
from thermoforce_mpc.free_response.backbones.loading import SHIPPED, load_backbone, shipped_folder
from thermoforce_mpc.free_response.checks import LEVELS, checked_free
from thermoforce_mpc.free_response.persistence import Persistence
from thermoforce_mpc.types import DAY_S, HOUR_S, Array, Boundary, FreeForecast, History

__all__ = ["SHIPPED", "ChronosFreeResponse", "shipped_folder"]

# With less than a day of measurements a daily course cannot be known: persistence takes over and says so.
_SHORTEST_HISTORY_S = DAY_S
# Instance normalisation of fewer values than this says nothing.
_FEWEST_VALUES = 8
_SHORTEST_CONTEXT = 16


class ChronosFreeResponse:
    """`FreeResponse` by a frozen backbone: evaluation mode, no gradients, weights hashed on request."""

    name = "chronos"

    def __init__(self, backbone: str = SHIPPED, context_steps: int = 512) -> None:
        """Load the weights.

        Args:
            backbone: 'shipped', 'fracast', a local directory, or a hub name; see `load_backbone`.
            context_steps: how much of the history the model sees at most.

        Raises:
            ConfigError: `context_steps` is less than the 16 a patch has.
            BackboneError: see `load_backbone`.
        """
        if context_steps < _SHORTEST_CONTEXT:
            raise ConfigError(
                f"context_steps is {context_steps}: backbones read patches of {_SHORTEST_CONTEXT}, give at least that"
            )
        self.backbone = backbone
        self._context_steps = context_steps
        self._model = load_backbone(backbone)
        self._short = Persistence()

    @property
    def label(self) -> str:
        """What it is, for reports."""
        return self._model.label

    def weight_hash(self) -> str:
        """SHA-256 over names, shapes and values of all weights: equal before and after a run, since they are frozen."""
        digest = hashlib.sha256()
        for index, module in enumerate(self._model.modules):
            for name, tensor in sorted(module.state_dict().items()):
                digest.update(f"{index}.{name}{tuple(tensor.shape)}".encode())
                digest.update(tensor.detach().cpu().contiguous().float().numpy().tobytes())
        return digest.hexdigest()

    def forecast(self, free_C: Array, history: History, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`. NaN gaps are passed to the model as they are, nothing is filled in.

        Raises:
            DataError: no value was ever measured, history and forecast differ in step, or the model's answer is not
                finite.
        """
        import torch

        free = checked_free(free_C, history)
        if history.n_steps and abs(history.step_s - boundary.step_s) > 1e-6:
            raise DataError(f"history at {history.step_s:g} s and forecast at {boundary.step_s:g} s differ in step")
        context = free[-self._context_steps :]
        known, seen_values = int(np.isfinite(free).sum()), int(np.isfinite(context).sum())
        # A day has this many steps, and one more boundary.
        if known < round(_SHORTEST_HISTORY_S / boundary.step_s) + 1:
            hours = (known - 1) * boundary.step_s / HOUR_S
            return self._persistence(free, history, boundary, f"only {hours:g} h of history measured")
        if seen_values < _FEWEST_VALUES:
            why = f"only {seen_values} of the last {context.size} values were measured"
            return self._persistence(free, history, boundary, why)
        seen = Context(
            context,
            np.stack([history.T_out_C, history.solar_W_m2], axis=1)[-context.size :],
            np.stack([boundary.T_out_C, boundary.solar_W_m2], axis=1)[1:],
        )
        with _one_thread(), torch.inference_mode():
            quantiles = np.sort(self._model.quantiles_C(seen), axis=0)
        if quantiles.shape != (LEVELS.size, boundary.n_steps) or not np.isfinite(quantiles).all():
            raise DataError(f"{self.label} gave values of shape {quantiles.shape} that are not all finite")
        return FreeForecast(LEVELS, quantiles, self.label)

    def _persistence(self, free: Array, history: History, boundary: Boundary, why: str) -> FreeForecast:
        short = self._short.forecast(free, history, boundary)
        return FreeForecast(short.levels, short.quantiles_C, f"persistence: {why}")


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread: sums in one order give the same bits, and such small models gain nothing by more."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
