"""What a scenario gives that was run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from thermoforce_mpc.data import PlantInfo
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import suggestion
from thermoforce_mpc.simulation.closed_loop import RunResult
from thermoforce_mpc.simulation.comparison.equal_comfort import AsComfortable
from thermoforce_mpc.simulation.comparison.outcome import COST
from thermoforce_mpc.simulation.folder.planning import Planning, planning_of
from thermoforce_mpc.simulation.folder.run_folder import trajectory_frame

if TYPE_CHECKING:  # loaded only when a controller needs a model
    from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class ScenarioResult:
    """A scenario that was run: the controller's closed loop and its baselines' on the same plant and window.

    `identification` and `forecaster` are what the manifest says of the models and of the frozen weights. `equal`: the
    thermostat that is as comfortable; None where it was not searched.
    """

    scenario: Scenario
    plant: PlantInfo
    result: RunResult
    baselines: Mapping[str, RunResult]
    models: Mapping[str, ThermalModel]
    identification: Mapping[str, Any]
    forecaster: Mapping[str, Any]
    equal: AsComfortable | None = None

    @property
    def kpis(self) -> dict[str, dict[str, float]]:
        """BOPTEST's KPIs by controller, the scenario's own first."""
        return {name: dict(result.kpis) for name, result in self._results().items()}

    @property
    def planning(self) -> dict[str, Planning]:
        """How each controller planned: solves by solver, calls of the exported operator, parameters."""
        return {name: planning_of(result, self.models.get(name)) for name, result in self._results().items()}

    def to_dataframe(self, controller: str | None = None) -> pd.DataFrame:
        """The trajectory of a controller, by default the scenario's own; one row per applied block.

        Raises:
            ConfigError: no controller of that name was run.
        """
        results = self._results()
        name = controller or self.result.controller
        if name not in results:
            raise ConfigError(f"no run of '{name}'{suggestion(name, results)}; there are {', '.join(results)}")
        return trajectory_frame(results[name].steps)

    def equal_in_words(self, currency: str) -> str:
        """The controller beside a thermostat that is as comfortable; '' where none was searched."""
        if self.equal is None:
            return ""
        return f"{self.result.controller} costs {self.equal.in_words(self.result.kpis[COST], currency)}"

    def _results(self) -> dict[str, RunResult]:
        return {self.result.controller: self.result, **self.baselines}
