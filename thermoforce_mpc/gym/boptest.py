"""BOPTEST-Gym's names: a script written for it runs after its import line is changed.

```python
from thermoforce_mpc.gym.boptest import EmbeddedBoptestGymEnv as BoptestGymEnv, NormalizedObservationWrapper
```
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.errors import ConfigError, suggestion
from thermoforce_mpc.files import storage_errors
from thermoforce_mpc.gym.env import BuildingEnv, Episodes
from thermoforce_mpc.gym.sources import EmbeddedSource, PointSource, ServiceSource
from thermoforce_mpc.gym.view import PointsView
from thermoforce_mpc.gym.wrappers import DiscretizedActionWrapper, NormalizedActionWrapper, NormalizedObservationWrapper
from thermoforce_mpc.plants.embedded.cases import CASES

__all__ = [
    "BoptestGymEnv",
    "DiscretizedActionWrapper",
    "EmbeddedBoptestGymEnv",
    "NormalizedActionWrapper",
    "NormalizedObservationWrapper",
]

_ROOM_K = (280.0, 310.0)
_ROOMS = ("reaTZon_y", "reaTRoo_y", "zon_reaTRooAir_y")


def check_keywords(given: Iterable[str], *takers: Callable[..., Any]) -> None:
    """Raise `ConfigError` for a name that none of `takers` has a parameter of."""
    variable = inspect.Parameter.VAR_KEYWORD
    parameters = [one for taker in takers for one in inspect.signature(taker).parameters.values()]
    known = sorted({one.name for one in parameters if one.kind is not variable})
    for name in given:
        if name not in known:
            raise ConfigError(f"unknown argument '{name}'{suggestion(name, known)}; known: {', '.join(known)}")


class BoptestGymEnv(BuildingEnv):
    """A test case of a BOPTEST service, with the arguments of BOPTEST-Gym (github.com/ibpsa/project1-boptest-gym).

    What differs: observations are clipped to their bounds, as Gymnasium asks; `reset(seed)` determines the episode, and
    random starts are whole steps; the number of a discretised action of several points counts every combination once;
    closing the environment stops the test.

    Attributes:
        url, testcase, testid, actions: as given, and the name of the test at the service.
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:5000",
        testcase: str = "bestest_hydronic_heat_pump",
        actions: Sequence[str] = ("oveHeaPumY_u",),
        observations: Mapping[str, tuple[float, float]] | None = None,
        *,
        max_episode_length: float = 3 * 3600,
        random_start_time: bool = False,
        excluding_periods: Sequence[tuple[float, float]] | None = None,
        regressive_period: float | None = None,
        predictive_period: float | None = None,
        start_time: float = 0.0,
        warmup_period: float = 0.0,
        scenario: Mapping[str, Any] | None = None,
        step_period: float = 900.0,
        discomfort_weight: float = 1.0,
        reward: Callable[[BuildingEnv], float] | None = None,
        render_episodes: bool = False,
        log_dir: str | None = None,
        render_mode: str | None = None,
        **source: Any,
    ) -> None:
        """Select the test case.

        Args:
            url: address of the service.
            testcase: name of the test case there.
            actions: inputs that are overwritten, `<point>_u`.
            observations: bounds by name of measurement or forecast, in the units of the interface; or 'time', which is
                then observed modulo its upper bound, s. Default: the zone temperature from 280 to 310 K.
            max_episode_length: length of an episode, s.
            random_start_time: draw the start of each episode, see `Episodes`.
            excluding_periods: pairs of times, s, that no drawn episode overlaps.
            regressive_period: length of the past of every measurement, s.
            predictive_period: length of the forecasts, s.
            start_time: start of the episodes, s since 1 January.
            warmup_period: native control before each episode, s.
            scenario: BOPTEST's scenario, such as `{"electricity_price": "dynamic"}`.
            step_period: length of a step, s.
            discomfort_weight: weight of tdis_tot beside cost_tot in the reward.
            reward: see `BuildingEnv`.
            render_episodes: draw each episode that ends into `log_dir`, episode_1.png and on.
            log_dir: folder of these pictures; default: the current one.
            render_mode: see `BuildingEnv`.
            source: further arguments of the source of the points.

        Raises:
            ConfigError: an argument does not fit the test case; names it.
            PlantError: the service cannot be reached or failed.
        """
        check_keywords(source, BoptestGymEnv, self._source)
        source_of = self._source(url, testcase, **source)
        try:
            view = PointsView(
                source_of,
                actions,
                dict(observations) if observations else {self._room(source_of): _ROOM_K},
                step_s=float(step_period),
                predictive_s=predictive_period,
                regressive_s=regressive_period,
            )
            episodes = Episodes(
                step_period=float(step_period),
                max_episode_length=float(max_episode_length),
                warmup_period=float(warmup_period),
                start_time=float(start_time),
                random_start_time=random_start_time,
                excluding_periods=excluding_periods,
                ahead=float(predictive_period or 0.0),
                behind=float(regressive_period or 0.0),
            )
            super().__init__(
                view,
                episodes,
                scenario=scenario,
                discomfort_weight=discomfort_weight,
                reward=reward,
                render_mode="rgb_array" if render_episodes else render_mode,
            )
        except BaseException:
            source_of.close()
            raise
        self.url, self.testcase, self.actions = url, testcase, list(actions)
        self.testid = getattr(source_of, "testid", "")
        self.warmup_period, self.predictive_period = warmup_period, predictive_period
        self.regressive_period, self.random_start_time = regressive_period, random_start_time
        self.excluding_periods, self.render_episodes = excluding_periods, render_episodes
        self.lower_obs_bounds, self.upper_obs_bounds = list(view.box.low), list(view.box.high)
        self.log_dir, self._drawn = Path(log_dir or "."), 0

    def step(self, action: Any) -> Any:
        """See `BuildingEnv.step`; with `render_episodes`, the end of an episode is drawn."""
        result = super().step(action)
        if self.render_episodes and (result[2] or result[3]):
            import matplotlib.image

            self._drawn += 1
            with storage_errors(self.log_dir):
                self.log_dir.mkdir(parents=True, exist_ok=True)
            matplotlib.image.imsave(self.log_dir / f"episode_{self._drawn}.png", self.render())
        return result

    def stop(self) -> None:
        """Stop the test."""
        self.close()

    @staticmethod
    def _room(source: PointSource) -> str:
        """The zone temperature, by the names of the test cases of one zone."""
        return next((name for name in _ROOMS if name in source.measurements), _ROOMS[0])

    def _source(self, url: str, testcase: str) -> PointSource:
        return ServiceSource(url, testcase)


class EmbeddedBoptestGymEnv(BoptestGymEnv):
    """As `BoptestGymEnv` on an embedded emulator, in this process.

    `url` is accepted so that scripts need no other change; nothing is sent to it. `weather` is a `Weather` year, by
    default a synthetic one of the test case's climate.
    """

    def _source(self, url: str, testcase: str, weather: Weather | None = None) -> PointSource:
        if testcase not in CASES:
            raise ConfigError(
                f"testcase: no embedded plant implements '{testcase}', those do for {', '.join(CASES)}; use "
                "BoptestGymEnv with the url of a service"
            )
        return EmbeddedSource(weather, testcase)
