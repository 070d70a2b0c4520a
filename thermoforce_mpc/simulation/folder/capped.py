"""How far metered power stayed below a cap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.plants.kpis import PEAK_WINDOW_S, window_means
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.simulation.closed_loop import RunResult


@dataclass(frozen=True)
class Capped:
    """Mean power of all machines over `steps` windows of `step_s` seconds: how many are `above` `cap_kW`; the highest.

    Windows in which power was not metered are not among them; without any the highest is NaN.
    """

    cap_kW: float
    step_s: float
    above: int
    steps: int
    highest_kW: float

    def in_words(self) -> str:
        """As 'above the cap of 3 kW: 0 of 192 quarter hours, highest 2.90 kW'."""
        of = "quarter hours" if self.step_s == PEAK_WINDOW_S else f"steps of {self.step_s / 60.0:g} min"
        return (
            f"above the cap of {self.cap_kW:g} kW: {self.above} of {self.steps} {of}, highest {self.highest_kW:.2f} kW"
        )


def capped_figures(
    scenario: Scenario, result: RunResult, baselines: Mapping[str, RunResult]
) -> dict[str, dict[str, Any]]:
    """What each run made of the cap of the scenario's controller, as `Capped` in JSON; {} without a cap."""
    cap_kW = (scenario.controller.options.get("objective") or {}).get("power_cap_kW")
    if cap_kW is None or not result.steps:
        return {}
    step_s = sum(sample.duration_s for sample in result.steps[0].samples)
    runs = {result.controller: result, **baselines}
    return {name: asdict(_capped(1000.0 * cap_kW, step_s, _means_W(run, step_s))) for name, run in runs.items()}


def _capped(cap_W: float, step_s: float, means_W: Array) -> Capped:
    known_W = means_W[np.isfinite(means_W)]
    highest_W = float(known_W.max()) if known_W.size else float("nan")
    return Capped(cap_W / 1000.0, step_s, int((known_W > cap_W).sum()), known_W.size, highest_W / 1000.0)


def _means_W(run: RunResult, step_s: float) -> Array:
    """Metered mean power of all machines over windows of `step_s` seconds, NaN where it was not metered."""
    samples = (sample for step in run.steps for sample in step.samples)
    starts_s, lengths_s, power_W = np.array([(s.start_s, s.duration_s, s.power_W.sum()) for s in samples]).T
    ends_s = np.append(starts_s[0], starts_s + lengths_s)
    unknown = window_means(ends_s, np.isnan(power_W), step_s) > 0.0
    return np.where(unknown, np.nan, window_means(ends_s, np.nan_to_num(power_W), step_s))
