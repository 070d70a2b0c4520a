"""The plants of the bench: clean ones, on which every claim is false, and the same with one fault each."""

from __future__ import annotations

import atexit
import math
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.chaos.fmu.building import build_house
from benchmarks.detectors.air_unit import LightOffice
from benchmarks.faults.faulty_plant import FaultyPlant
from controllers import ThermoForceMPC
from controllers.mpc.planner import build_solver
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, Solver
from thermoforce_mpc.boundary.weather import CONTINENTAL, MARITIME, synthetic_weather
from thermoforce_mpc.data import (
    DAY_S,
    HOUR_S,
    Array,
    Boundary,
    Layout,
    Levels,
    Measurement,
    Observation,
    Period,
    Plan,
    PlantInfo,
    Record,
)
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.live.windows import as_if_empty, open_windows
from thermoforce_mpc.live.windows import without as without_readings
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.plants.drawn_houses import AIR_WH_M3_K, GRID_S, HEIGHT_M, WEEKS
from thermoforce_mpc.plants.embedded import EmbeddedPlant, PointEmulator
from thermoforce_mpc.plants.energyplus.zone import EnergyPlusPlant
from thermoforce_mpc.plants.fmu import FmuPlant
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house, physics, with_sunlit_part
from thermoforce_mpc.plants.random_houses.draw import House
from thermoforce_mpc.plants.rooms import HouseOfRooms, house_of_rooms
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.testcase import TestCase

# Start days of the embedded plant: winter, late winter, spring and autumn.
_SEASONS = ("16", "44", "108", "290")
# Outdoors in the mean, °C, and most sun, W/m², of an air unit in winter, spring and summer.
_AIR = ((-4.0, 400.0), (3.0, 600.0), (12.0, 800.0), (24.0, 800.0))
# Windows of BOPTEST's test cases.
_HEAT_WINDOWS, _COOL_WINDOWS = ("peak_heat_day", "typical_heat_day"), ("peak_cool_day", "typical_cool_day")
# Zones of EnergyPlus and their first days.
_ZONES = (("energyplus:heating_chicago", 12), ("energyplus:cooling_phoenix", 190))
# A fault begins so long after the run, s; a day of it, if nothing else is said.
_AFTER_S = 2.0 * DAY_S
# Another load on the meter by day, W; sun on a sensor, K; hours until which a machine stands; lag of a sensor, s.
_OTHER_W, _SUN_K, _ASLEEP_H, _LATE_S = 400.0, 2.5, 5.0, 900.0
# Which houses of a draw have that sensor: others than those of the clean weeks.
_LATE_FROM, _LATE_EVERY = 2000, 100
# Which houses of a draw have a fixed loss, and rooms of a heat pump without one: others than those of the clean weeks.
_FIXED_FROM, _EVEN_FROM = 3000, 50
# Air changes, 1/h, of all windows together, wide open: twice the most of `plants.people`, whose windows are not all
# open. For so long, s: twice a day, as people air, and once, forgotten.
_WIDE_1_H, _AIRED_S, _FORGOTTEN_S = 6.0, 900.0, 2.0 * HOUR_S
# When people air, and when they forget it in the evening of the third day, h.
_AIRINGS_H, _EVENING_H = (7.0, 20.0), 19.0
# Fewest plants of a fault: of readings in half degrees three days say nothing of a lag.
_LEAST = {"late sensor": 3}
# Hours of the morning in which a schedule acts, and how many times the ventilation that it blows in then.
_MORNING_H, _PURGES = (6.0, 7.5), 4.0
# How far a door moves a sensor, K; a quarter of an hour, s; share of the name plate's heat that a worn machine gives.
_DOOR_K, _QUARTER_S, _OF_PLATE = 1.0, 900.0, 0.65
# How far a sensor is off that was moved, K, and how late its casing and the wall make it there, s.
_MOVED_K, _MOVED_LAG_S = 2.0, 1.5 * HOUR_S
_NAME = re.compile(r"(.+) (\d+) of (\d+)(?:, (.+))?", re.ASCII)
# Air through a door that stands open all day (`plants.rooms.draw`), W/K^1.5.
_OPEN_W_K15 = 121.0


@dataclass(frozen=True)
class PanelCase:
    """A house-week: `kind` and `number` of the plant, drawn with `seed`; `fault`: the rule that one is for, or ''."""

    kind: str
    number: int
    seed: int
    fault: str = ""

    @property
    def in_words(self) -> str:
        """For people and tables: weeks of the same words are the same plant and week."""
        return f"{self.kind} {self.number} of {self.seed}" + (f", {self.fault}" if self.fault else "")

    @classmethod
    def named(cls, words: str) -> PanelCase:
        """The case of these words; raises `InputError` where no case has them."""
        found = _NAME.fullmatch(words)
        kind, fault = (found[1], found[4] or "") if found else ("", "")
        if found is None or kind not in KINDS or (fault and FAULTS.get(fault, ("",))[0] != kind):
            raise InputError(
                f"week '{words}': expected 'KIND NUMBER of SEED' or 'KIND NUMBER of SEED, FAULT' of the panel"
            )
        return cls(kind, int(found[2]), int(found[3]), fault)


@dataclass(frozen=True)
class BuiltCase:
    """A plant with its test case and scored window; `fixed`: whether its machine has a fixed loss; `late_s`: time
    constant of its zone sensor, s; `acts`: who controls it, of the controller and the name of the rule that it is to do
    without, or ''.
    """

    plant: Any
    testcase: TestCase
    period: Period
    fixed: bool = False
    late_s: float = 0.0
    acts: Callable[[Any, str], Any] = lambda controller, without: controller


def clean(weeks: int, seed: int) -> list[PanelCase]:
    """So many house-weeks, each kind in turn."""
    return [PanelCase(list(KINDS)[n % len(KINDS)], n // len(KINDS), seed) for n in range(weeks)]


def faulty(each: int, seed: int, only: Sequence[str] = ()) -> list[PanelCase]:
    """`each` plants with each fault, and `_LEAST` of those that not every record can show.

    `only`: of faults whose names begin so, if any are given; raises `InputError` for one that none does.
    """
    for start in only:
        if not any(fault.startswith(start) for fault in FAULTS):
            raise InputError(f"fault '{start}': none begins so; there are: {'; '.join(FAULTS)}")
    return [
        PanelCase(kind, number, seed, fault)
        for fault, (kind, _) in FAULTS.items()
        if not only or fault.startswith(tuple(only))
        for number in range(max(each, _LEAST.get(fault, each)) if each else 0)
    ]


def built(case: PanelCase) -> BuiltCase:
    """The plant of a case."""
    found = KINDS[case.kind](case)
    if not case.fault:
        return found
    return FAULTS[case.fault][1](found, case)


def _embedded(case: PanelCase) -> BuiltCase:
    """The heat pump of BOPTEST's house, one season after another; from the second round on, days later."""
    plant = EmbeddedPlant(synthetic_weather())
    day = int(_SEASONS[case.number % len(_SEASONS)]) + 5 * (case.number // len(_SEASONS))
    return BuiltCase(plant, load_testcase("bestest_hydronic_heat_pump"), plant.period(str(day)), fixed=True)


def _drawn(case: PanelCase) -> BuiltCase:
    """A generated house whose sensor is not in the sun."""
    return _house_week(draw_house(case.seed, case.number), WEEKS[case.number % 2])


def _sunlit(case: PanelCase) -> BuiltCase:
    """A generated house in which the sun heats the floor or a double-skin glazing first."""
    return _house_week(with_sunlit_part(draw_house(case.seed, case.number)), WEEKS[(case.number + 1) % 2])


def _house_week(house: House, week: str) -> BuiltCase:
    house = replace(house, sun_bias_K=0.0)
    plant = GeneratedHousePlant(house)
    fixed = house.machine == "heat pump with fixed loss"
    return BuiltCase(plant, plant.testcase, plant.period(week), fixed, house.lag_s)


def _air(case: PanelCase) -> BuiltCase:
    """A unit that heats and cools by room set-points, one season after another."""
    rng = np.random.default_rng([case.seed, case.number, 11])
    mean_C, sun = _AIR[case.number % len(_AIR)]
    plant = LightOffice(mean_C + float(rng.uniform(-2.0, 2.0)), sun * float(rng.uniform(0.8, 1.2)))
    return BuiltCase(plant, load_testcase("bestest_air"), plant.period(str(30 + int(rng.integers(0, 20)))))


def _rooms(use: str) -> Callable[[PanelCase], BuiltCase]:
    def of(case: PanelCase) -> BuiltCase:
        name = f"{use}:3rooms:{100 * case.seed + case.number}"
        plant = house_of_rooms(name)
        return BuiltCase(plant, load_testcase(name), plant.period(WEEKS[case.number % 2]), fixed=True)

    return of


def _even_rooms(case: PanelCase) -> BuiltCase:
    """A house of rooms whose heat pump has no fixed loss: at part load heat costs what the water makes it cost."""
    found = _rooms("house")(replace(case, number=_EVEN_FROM + case.number))
    house = found.plant.house
    plant = HouseOfRooms(replace(house, heat_pump=replace(house.heat_pump, fixed_W=0.0)))
    return replace(found, plant=plant, fixed=False)


def _by_points(name: str, days: tuple[str, ...]) -> Callable[[PanelCase], BuiltCase]:
    """An embedded plant that acts by the points of its test case file, one of its windows after another.

    From the second round on in other years: weeks that are alike tell no more than one of them.
    """

    def of(case: PanelCase) -> BuiltCase:
        testcase = load_testcase(name)
        lap = case.number // len(days)
        climate = CONTINENTAL if name == "bestest_air" else MARITIME
        plant = PointEmulator(testcase, synthetic_weather(case.seed + lap if lap else 0, climate=climate))
        return BuiltCase(plant, testcase, plant.period(days[case.number % len(days)]))

    return of


def _zone(case: PanelCase) -> BuiltCase:
    """A zone of EnergyPlus (extra [energyplus]): heating in Chicago and cooling in Phoenix in turn, then days later."""
    name, first_day = _ZONES[case.number % len(_ZONES)]
    testcase = load_testcase(name)
    plant = EnergyPlusPlant(testcase)
    return BuiltCase(plant, testcase, plant.period(str(first_day + 7 * (case.number // len(_ZONES)))))


def _fmu(case: PanelCase) -> BuiltCase:
    """The embedded heat pump as an FMU (extra [fmu]) with a synthetic year of its own, one season after another."""
    plant = FmuPlant(_house_file(), load_testcase("bestest_hydronic_heat_pump"))
    day = int(_SEASONS[case.number % len(_SEASONS)]) + 7 * (case.number // len(_SEASONS)) + 3
    return BuiltCase(plant, plant.testcase, plant.period(str(day)), fixed=True)


@cache
def _house_file() -> Path:
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    return build_house(Path(folder.name))


KINDS: dict[str, Callable[[PanelCase], BuiltCase]] = {
    "generated house": _drawn,
    "embedded": _embedded,
    "generated house, other": lambda case: _drawn(replace(case, number=1000 + case.number)),
    "air unit": _air,
    "office": _rooms("office"),
    "bestest_air": _by_points(
        "bestest_air", ("peak_heat_day", "peak_cool_day", "typical_heat_day", "typical_cool_day")
    ),
    "bestest_hydronic": _by_points("bestest_hydronic", ("peak_heat_day", "typical_heat_day")),
    "house of rooms": _rooms("house"),
    "EnergyPlus zone": _zone,
    "FMU": _fmu,
    "sunlit house": _sunlit,
    "house of rooms, no fixed part": _even_rooms,
}
"""Plants by kind; generated houses are drawn twice as often as the rest."""


class MeddledPlant:
    """A plant with `shows` between its meters and who reads them, and `gives` between what is asked and its machine.

    `shows(time_s, duration_s, measurement)`; `gives(time_s, level)`.
    """

    def __init__(
        self,
        plant: Any,
        shows: Callable[[Measurement], Measurement] = lambda measurement: measurement,
        gives: Callable[[float, float | None], float | None] = lambda time_s, level: level,
        *,
        reports_asked: bool = False,
    ) -> None:
        """`reports_asked`: the level that is read is the one that was asked for, whatever is given."""
        self._plant, self._shows, self._gives = plant, shows, gives
        self._reports_asked = reports_asked
        self._now_s = 0.0

    @property
    def info(self) -> PlantInfo:
        """That of the plant."""
        return self._plant.info

    def period(self, name: str) -> Period:
        """See `Plant.period`."""
        return self._plant.period(name)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`."""
        self._now_s = start_s
        return self._shows(self._plant.reset(start_s, warmup_s, price))

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        """See `Plant.advance`; one actuator."""
        (level,) = u if isinstance(u, tuple | list) else (u,)
        found = self._shows(self._plant.advance(self._gives(self._now_s, level), duration_s))
        if self._reports_asked and level is not None:
            found = replace(found, u=np.array([level]))
        self._now_s = float(found.time_s)
        return found

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        return self._plant.forecast(horizon_s, interval_s)

    def past(self, step_s: float) -> Record:
        """See `Plant.past`; the machine was not meddled with then, the meters are left out."""
        record = self._plant.past(step_s)
        return replace(record, power_W=np.full_like(record.power_W, np.nan))

    def kpis(self) -> dict[str, float]:
        """See `Plant.kpis`."""
        return self._plant.kpis()

    def close(self) -> None:
        """See `Plant.close`."""
        self._plant.close()


class RebuiltPlant(MeddledPlant):
    """A plant that is another one from a reset at `from_s` on: what was probed is not what is controlled."""

    def __init__(self, probed: Any, controlled: Any, from_s: float) -> None:
        super().__init__(probed)
        self._both, self._from_s = (probed, controlled), from_s

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`."""
        self._plant = self._both[start_s >= self._from_s - 1.0]
        return self._plant.reset(start_s, warmup_s, price)

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        """See `Plant.advance`."""
        return self._plant.advance(u, duration_s)


def _with_doors(house: Any, open_W_K15: float) -> HouseOfRooms:
    return HouseOfRooms(replace(house, doors=tuple(replace(door, open_W_K15=open_W_K15) for door in house.doors)))


def _doors(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """Doors that stood wide open while probing and are shut since; every second case: the other way round."""
    opened, shut = (_with_doors(found.plant.house, W) for W in (_OPEN_W_K15, 0.0))
    probed, controlled = (opened, shut) if case.number % 2 == 0 else (shut, opened)
    return replace(found, plant=RebuiltPlant(probed, controlled, found.period.start_s))


def _new_schedule(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """An office whose schedule blows cold air and lets nothing come in the morning, since it was probed."""
    cold = _cold_mornings(found, case)
    probed = GeneratedHousePlant(replace(found.plant.house, pattern="office"))
    return replace(cold, plant=RebuiltPlant(probed, cold.plant, cold.period.start_s))


def _in_the_sun(found: BuiltCase, case: PanelCase) -> BuiltCase:
    house = replace(found.plant.house, sun_bias_K=_SUN_K, sun_facade="south")
    return replace(found, plant=GeneratedHousePlant(house))


def _late(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """A sensor in a thick case: as late as the latest of a draw; where the floor is heated nothing would show it."""
    houses = (draw_house(case.seed, number) for number in count(_LATE_FROM + case.number, _LATE_EVERY))
    house = next(house for house in houses if house.emitter != "floor")
    return _house_week(replace(house, lag_s=_LATE_S), WEEKS[case.number % 2])


def _with_fixed_loss(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """A house whose heat pump has a fixed loss."""
    houses = (draw_house(case.seed, number) for number in count(_FIXED_FROM + case.number, _LATE_EVERY))
    house = next(house for house in houses if house.machine == "heat pump with fixed loss")
    return _house_week(house, WEEKS[case.number % 2])


class _AiredHouse(GeneratedHousePlant):
    """A generated house whose windows stand wide open at `opened(time_s)` (n,)."""

    def __init__(self, house: House, opened: Callable[[Array], Array]) -> None:
        super().__init__(house)
        grid = self._grid.copy()
        wide_W_K = AIR_WH_M3_K * HEIGHT_M * house.floor_area_m2 * _WIDE_1_H
        grid[:, physics.VENTILATION] += wide_W_K * opened(GRID_S * np.arange(len(grid), dtype=np.float64))
        grid.setflags(write=False)
        self._grid = grid
        self.reset(0.0, 0.0)


def _aired(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """People open all windows for a quarter of an hour twice a day, somewhat later on each: also while probing."""
    rng = np.random.default_rng([case.seed, case.number, 19])
    later_s = _QUARTER_S * rng.integers(0, 5, size=(366, len(_AIRINGS_H)))

    def opened(time_s: Array) -> Array:
        day, of_day_s = (time_s // DAY_S).astype(int), time_s % DAY_S
        begins_s = HOUR_S * np.array(_AIRINGS_H) + later_s[day]
        now_s = of_day_s[:, None]
        return np.any((begins_s <= now_s) & (now_s < begins_s + _AIRED_S), axis=1).astype(np.float64)

    return replace(found, plant=_AiredHouse(found.plant.house, opened))


def _forgotten_window(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """All windows stand open from 19:00 on the third day for two hours, in a house as `tf-mpc control` keeps it."""
    from_s = found.period.start_s + _AFTER_S
    from_s += (_EVENING_H * HOUR_S - from_s) % DAY_S

    def opened(time_s: Array) -> Array:
        return np.asarray((from_s <= time_s) & (time_s < from_s + _FORGOTTEN_S), dtype=np.float64)

    def acts(controller: Any, without: str) -> Any:
        return controller if without == "open window" else AtHome(controller, found.testcase.layout)

    return replace(found, plant=_AiredHouse(found.plant.house, opened), acts=acts)


class AtHome:
    """A controller as `tf-mpc control` runs it: while a window is open, the room's readings and bounds do not count."""

    def __init__(self, controller: Any, layout: Layout) -> None:
        self._controller, self._layout = controller, layout

    def __getattr__(self, name: str) -> Any:
        """What else is asked of the controller."""
        return getattr(self._controller, name)

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """See `Controller.plan`."""
        windows = open_windows(observation.history, self._layout)
        history = without_readings(observation.history, windows)
        seen = replace(observation, history=history, boundary=as_if_empty(observation.boundary, windows))
        return self._controller.plan(seen, state)


class _Idle:
    """A solver that says for a day from `from_s` on that all off is best; `now_s()`: the time, s."""

    def __init__(self, inner: Solver, from_s: float, now_s: Callable[[], float]) -> None:
        self._inner, self._from_s, self._now_s = inner, from_s, now_s

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """See `Solver.solve`."""
        found = self._inner.solve(problem, guess)
        broken = self._from_s <= self._now_s() < self._from_s + DAY_S
        return replace(found, u=0.0 * found.u) if broken else found


class _WithIdleSolver:
    """The controller of a model whose solver fails for a day from `from_s` on."""

    def __init__(self, controller: Any, from_s: float) -> None:
        def solver(operator: BuildingOperator, shape: ProblemShape) -> Solver:
            return _Idle(build_solver(controller.config, operator, shape), from_s, lambda: self._now_s)

        self._now_s = -math.inf
        self._controller = ThermoForceMPC(controller.model, controller.config, solver=solver)

    def __getattr__(self, name: str) -> Any:
        """What else is asked of the controller."""
        return getattr(self._controller, name)

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """See `Controller.plan`."""
        self._now_s = observation.time_s
        return self._controller.plan(observation, state)


def _idle_solver(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """For a day from the third on the solver says that all off is best."""
    from_s = found.period.start_s + _AFTER_S

    def acts(controller: Any, without: str) -> Any:
        # Without a model there is no solver.
        return _WithIdleSolver(controller, from_s) if isinstance(controller, ThermoForceMPC) else controller

    return replace(found, acts=acts)


def _asleep(found: BuiltCase, case: PanelCase) -> BuiltCase:
    def gives(time_s: float, u: float | None) -> float | None:
        return 0.0 if time_s % DAY_S < _ASLEEP_H * HOUR_S - 1.0 else u

    return replace(found, plant=MeddledPlant(found.plant, gives=gives))


def _unit_asleep(found: BuiltCase, case: PanelCase) -> BuiltCase:
    mean_C, sun = _AIR[case.number % 2]
    return replace(found, plant=LightOffice(mean_C, sun, asleep_until_h=_ASLEEP_H))


class _ColdMornings(GeneratedHousePlant):
    """A generated house used as an office, whose ventilation blows outdoor air through it from 6:00 to 7:30."""

    def __init__(self, house: House) -> None:
        super().__init__(replace(house, pattern="office"))
        grid, hour = self._grid.copy(), np.mod(np.arange(len(self._grid)) * GRID_S, DAY_S) / HOUR_S
        grid[(hour >= _MORNING_H[0]) & (hour < _MORNING_H[1]), physics.VENTILATION] *= _PURGES
        self._grid = grid
        self.reset(0.0, 0.0)


def _cold_mornings(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """A morning in which the plant's schedule blows cold air and lets nothing come, and reports what was asked for.

    Every second one only lets nothing come.
    """
    house = found.plant.house
    office = _ColdMornings(house) if case.number % 2 == 0 else GeneratedHousePlant(replace(house, pattern="office"))

    def stands(time_s: float) -> bool:
        return _MORNING_H[0] <= (time_s % DAY_S + 1.0) / HOUR_S < _MORNING_H[1]

    def gives(time_s: float, u: float | None) -> float | None:
        return 0.0 if u is not None and stands(time_s) else u

    plant = MeddledPlant(office, gives=gives, reports_asked=True)
    return replace(found, plant=plant, testcase=office.testcase, period=office.period("cold_week"))


def _other_load(W: float, since: Callable[[float, Period], bool]) -> Callable[[BuiltCase, PanelCase], BuiltCase]:
    """Another load of `W` by day on the meter, at times `since` says of the controlled week."""

    def of(found: BuiltCase, case: PanelCase) -> BuiltCase:
        def shows(measurement: Measurement) -> Measurement:
            time_s = float(measurement.time_s)
            on = 6.0 <= time_s % DAY_S / HOUR_S <= 18.0 and since(time_s, found.period)
            return replace(measurement, power_W=measurement.power_W + (W if on else 0.0))

        return replace(found, plant=MeddledPlant(found.plant, shows))

    return of


def _wh_per_step(found: BuiltCase, case: PanelCase) -> BuiltCase:
    return replace(found, plant=MeddledPlant(found.plant, lambda seen: replace(seen, power_W=0.25 * seen.power_W)))


def _changed(fault: Any, days: float = 1.0, **options: Any) -> Callable[[BuiltCase, PanelCase], BuiltCase]:
    def of(found: BuiltCase, case: PanelCase) -> BuiltCase:
        from_s = found.period.start_s + _AFTER_S
        return replace(found, plant=FaultyPlant(found.plant, fault, from_s, from_s + days * DAY_S, **options))

    return of


def _anothers_sensor(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """The zone sensor tells of a door that opens and shuts: the room with an Ornstein-Uhlenbeck process of an hour."""
    rng = np.random.default_rng([case.seed, case.number, 17])
    away_K = np.zeros(round(365 * DAY_S / _QUARTER_S))
    for k, noise in enumerate(rng.normal(size=away_K.size - 1)):
        away_K[k + 1] = 0.78 * away_K[k] + 0.63 * _DOOR_K * noise

    def shows(measurement: Measurement) -> Measurement:
        return replace(measurement, T_zone_C=measurement.T_zone_C + away_K[int(measurement.time_s // _QUARTER_S)])

    return replace(found, plant=MeddledPlant(found.plant, shows))


def _moved_sensor(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """From the third day on, for a day, the zone sensor reads 2 K more, and late."""
    from_s = found.period.start_s + _AFTER_S
    last: dict[str, Any] = {}

    def shows(measurement: Measurement) -> Measurement:
        now_s = float(measurement.time_s)
        if not from_s < now_s <= from_s + DAY_S:
            last.clear()
            return measurement
        before_C = last.get("C", measurement.T_zone_C)
        share = 1.0 - np.exp(-(now_s - last.get("s", from_s)) / _MOVED_LAG_S)
        last.update(s=now_s, C=before_C + share * (measurement.T_zone_C + _MOVED_K - before_C))
        return replace(measurement, T_zone_C=last["C"])

    return replace(found, plant=MeddledPlant(found.plant, shows))


def _stuck_meters(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """From the third day on outdoor sensor (every second case: power meter) repeats its reading."""
    from_s, kept = found.period.start_s + _AFTER_S, dict[str, Any]()
    name = "power_W" if case.number % 2 else "T_out_C"

    def shows(measurement: Measurement) -> Measurement:
        if measurement.time_s < from_s or not kept:
            kept[name] = getattr(measurement, name)
        return replace(measurement, **kept)

    return replace(found, plant=MeddledPlant(found.plant, shows))


def _weaker_than_named(found: BuiltCase, case: PanelCase) -> BuiltCase:
    """Its heat pump has two thirds of the heat that its name plate has."""
    house = found.plant.house
    pump = replace(house.heat_pump, capacity_W=house.heat_pump.capacity_W * _OF_PLATE)
    return replace(found, plant=HouseOfRooms(replace(house, heat_pump=pump)))


FAULTS: dict[str, tuple[str, Callable[[BuiltCase, PanelCase], BuiltCase]]] = {
    "sun on a sensor": ("generated house", _in_the_sun),
    "late sensor": ("generated house", _late),
    "hours of the day": ("generated house", _asleep),
    "hours of the day of a unit": ("air unit", _unit_asleep),
    "hours of the day, less effect": ("generated house", _cold_mornings),
    "other load": ("generated house", _other_load(_OTHER_W, lambda time_s, week: True)),
    "other load, ended": (
        "generated house",
        _other_load(2.0 * _OTHER_W, lambda time_s, week: time_s <= week.start_s),
    ),
    "other load, begun": (
        "generated house",
        _other_load(2.0 * _OTHER_W, lambda time_s, week: time_s > week.start_s + _AFTER_S),
    ),
    "watch": ("embedded", _changed("weak")),
    "watch, stays weak": ("embedded", _changed("weak", days=math.inf)),
    "watch, sensor moved": ("generated house", _moved_sensor),
    "watch, actuator stuck": ("embedded", _changed("stuck", level=0.0)),
    "guard": ("embedded", _changed("window")),
    "zone sensor": ("embedded", _changed("offset", offset_K=3.0)),
    "zone sensor, frozen": ("embedded", _changed("frozen")),
    "units": ("embedded", _wh_per_step),
    "gate": ("generated house", _anothers_sensor),
    "meters and weather sensors": ("generated house", _stuck_meters),
    "shared machine at its limit": ("house of rooms", _weaker_than_named),
    "watch, doors": ("house of rooms", _doors),
    "hours of the day, since probed": ("generated house", _new_schedule),
    "fixed part": ("generated house", _with_fixed_loss),
    "fixed part, of rooms": ("house of rooms", lambda found, case: found),
    "air through windows": ("generated house", _aired),
    "open window": ("generated house", _forgotten_window),
    "rule's levels": ("generated house", _idle_solver),
}
"""Faults by the rule they are for (up to a comma or 'of a'): the kind of plant, and what is done to it."""
