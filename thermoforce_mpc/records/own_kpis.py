"""KPIs of the user's own: functions of a trajectory, in `file.py:name` or handed to `run`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import DoubtfulInput
from thermoforce_mpc.loop.closed_loop import RunResult
from thermoforce_mpc.records.run_folder import trajectory_frame
from thermoforce_mpc.scenario.own_code import line_in, own_code

if TYPE_CHECKING:
    import pandas as pd

_MARK = ", "


@dataclass(frozen=True)
class OwnKpi:
    """A KPI by `key`, its name and unit as `starts_per_day, 1/d`, and the function that computes it."""

    key: str
    function: Callable[[pd.DataFrame], float]

    def of(self, trajectory: pd.DataFrame) -> float:
        """The KPI; NaN with a warning that says where, if the function raises or gives no number."""
        try:
            return float(self.function(trajectory))
        except Exception as error:  # whatever a function of the user raises: the run is over, nothing of it is lost
            at = line_in(self.function.__code__.co_filename, error) if hasattr(self.function, "__code__") else ""
            warnings.warn(f"kpis: {self.key}{at}: {type(error).__name__}: {error}", DoubtfulInput, stacklevel=2)
            return float("nan")


def own_kpis(given: Iterable[str | Callable[[pd.DataFrame], float]]) -> tuple[OwnKpi, ...]:
    """KPIs from functions, or from where they stand (`file.py:name`).

    Name and unit are the function's name, and what follows the last comma of the first line of its docstring:
    `def starts_per_day(trajectory): "Starts of the machine, 1/d"`.

    Raises:
        ConfigError: there is no such function, or two have one name.
    """
    found = []
    for one in given:
        function = own_code(one, "kpis", ConfigError) if isinstance(one, str) else one
        name = getattr(function, "__name__", type(function).__name__)
        words = (function.__doc__ or "").strip().partition("\n")[0]
        unit = words.rpartition(",")[2].strip(" .") if "," in words else ""
        found.append(OwnKpi(f"{name}{_MARK}{unit or '–'}", function))
    twice = {kpi.key for kpi in found if sum(other.key == kpi.key for other in found) > 1}
    if twice:
        raise ConfigError(f"kpis: {', '.join(twice)}: given twice")
    return tuple(found)


def with_own_kpis(result: RunResult, own: Iterable[OwnKpi]) -> RunResult:
    """A result with its KPIs and those of the user's."""
    own = tuple(own)
    if not own:
        return result
    trajectory = trajectory_frame(result.steps)
    return replace(result, kpis=result.kpis | {kpi.key: kpi.of(trajectory) for kpi in own})


def own_of(kpis: Mapping[str, float | None]) -> dict[str, float | None]:
    """Those of `kpis` that are the user's, by name and unit."""
    return {key: value for key, value in kpis.items() if _MARK in key}
