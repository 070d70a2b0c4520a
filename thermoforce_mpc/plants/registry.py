"""Registry of plants by name: which one implements a scenario's building. A new plant needs one entry here.

Other distributions announce a class, a function or a `PlantEntry` in the group `thermoforce_mpc.plants`, see
docs/how-to/plugins.md. Comfort bounds of a scenario take the place of a plant's own.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from thermoforce_mpc.data import HOUR_S, Boundary, Measurement
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.protocols import Plant, StandsFor
from thermoforce_mpc.registry import Registry
from thermoforce_mpc.scenario.comfort import Comfort
from thermoforce_mpc.scenario.own_code import called, first_line, options_model, unfit
from thermoforce_mpc.scenario.scenario import PlantSpec
from thermoforce_mpc.scenario.settings import StrictModel, validate
from thermoforce_mpc.scenario.testcase import TestCase

if TYPE_CHECKING:
    from boptest_client import TransportConfig
    from thermoforce_mpc.boundary.forecast_error import ForecastError
    from thermoforce_mpc.boundary.tariffs import Tariff
    from thermoforce_mpc.boundary.weather import SyntheticClimate
    from thermoforce_mpc.boundary.weather.year import Weather
    from thermoforce_mpc.data import Array
    from thermoforce_mpc.plants.embedded.emulator import Emulator


# Distance of the readings from which discomfort is integrated, s.
_SAMPLE_S = 60.0


class WithComfort(StandsFor):
    """A `Plant` with the comfort bounds of a schedule in forecasts and KPIs; all else is that of the plant inside.

    Discomfort is integrated over readings a minute apart, by the trapezoidal rule: where a plant's own discomfort is
    that of true temperatures, this one has the error of its sensors.
    """

    def __init__(self, plant: Plant, comfort: Comfort, testcase: TestCase) -> None:
        """Wrap `plant`; raises `ConfigError` for a zone that the test case does not have."""
        super().__init__(plant)
        self._comfort, self._zones = comfort, testcase.layout.names.zones
        # The engine's year begins on a Monday, BOPTEST's and that of drawn houses on a Tuesday.
        self._first = "monday" if testcase.energyplus or testcase.plant == "small_office" else "tuesday"
        self._start_s = 0.0
        self._comfort.bounds_C(np.zeros(1), self._zones, self._first)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`."""
        self._start_s = float(start_s)
        return self._inside.reset(start_s, warmup_s, price)

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        ahead = self._inside.forecast(horizon_s, interval_s)
        lower, upper = self._comfort.bounds_C(ahead.time_s, self._zones, self._first)
        return replace(ahead, lower_C=lower, upper_C=upper)

    def kpis(self) -> dict[str, float]:
        """See `Plant.kpis`; discomfort in K·h also zone by zone."""
        return dict(self._inside.kpis()) | self._discomfort()

    def _discomfort(self) -> dict[str, float]:
        record = self._inside.past(_SAMPLE_S)
        scored = record.time_s >= self._start_s
        time_s, T_zone = record.time_s[scored], record.T_zone_C[:, scored]
        outside = excess(T_zone, *self._comfort.bounds_C(time_s, self._zones, self._first))
        of_zones = np.atleast_1d(np.trapezoid(np.nan_to_num(outside), time_s / HOUR_S, axis=1))
        named = {f"tdis_tot[{zone}]": float(Kh) for zone, Kh in zip(self._zones, of_zones, strict=True)}
        return {"tdis_tot": float(of_zones.mean()), **(named if len(self._zones) > 1 else {})}


WEATHER, PRICES, UNCERTAINTY, PEOPLE = "weather", "prices_file", "forecast_uncertainty", "people"


class NoOptions(StrictModel):
    """A plant without options of its own."""


@dataclass(frozen=True)
class PlantEntry:
    """A plant as it is registered.

    Attributes:
        summary: one line for `tf-mpc plants`.
        build: makes it from the scenario's `plant`, the test case, its validated options and a seed.
        config: returns the class of its options (scenario key `plant.options`).
        takes: keys of the scenario's `plant` that it heeds, of weather, prices_file, forecast_uncertainty and people.
        missing: says what has to be installed first, or nothing.
        windows: names of its windows beside start days; None where only the plant itself knows them.
        implements: whether it is the plant of a test case that names none.
        attach: takes up the test of this name that a plant which goes on without us has; None for all others.
    """

    summary: str
    build: Callable[[PlantSpec, TestCase, Any, int], Plant]
    config: Callable[[], type[StrictModel]] = lambda: NoOptions
    takes: frozenset[str] = frozenset()
    missing: Callable[[], str] = lambda: ""
    windows: Callable[[PlantSpec, TestCase], Collection[str] | None] = lambda spec, testcase: None
    implements: Callable[[TestCase], bool] = lambda testcase: False
    attach: Callable[[PlantSpec, TestCase, int, str], Plant] | None = None


@dataclass(frozen=True)
class ChosenPlant:
    """A plant that was looked up and whose options were checked, once; `comfort` takes the place of its own bounds."""

    name: str
    entry: PlantEntry
    spec: PlantSpec
    options: StrictModel
    testcase: TestCase
    seed: int
    comfort: Comfort | None = None

    @property
    def outlives_us(self) -> bool:
        """Whether it goes on while we are down."""
        return self.entry.attach is not None

    def build(self, testid: str | None = None) -> Plant:
        """The plant; with `testid` the test that a service has already.

        Raises:
            ConfigError: the FMU cannot be used, or a zone of `comfort` does not fit the plant.
            WeatherError: the weather file cannot be used.
            NoSuchTest, PlantError: the service does not answer.
        """
        if testid is not None and self.entry.attach is not None:
            plant = self.entry.attach(self.spec, self.testcase, self.seed, testid)
        else:
            plant = self.entry.build(self.spec, self.testcase, self.options, self.seed)
        return with_comfort(plant, self.comfort, self.testcase)


def build_plant(spec: PlantSpec, testcase: TestCase, seed: int, comfort: Comfort | None = None) -> Plant:
    """Build the plant of a scenario; raises as `choose_plant` and `ChosenPlant.build`."""
    return choose_plant(spec, testcase, seed, comfort).build()


def with_comfort(plant: Plant, comfort: Comfort | None, testcase: TestCase) -> Plant:
    """`plant` with the comfort bounds of a scenario, where it has any; raises `ConfigError` for an unknown zone."""
    if comfort is None:
        return plant

    return cast(Plant, WithComfort(plant, comfort, testcase))


def plant_name(spec: PlantSpec, testcase: TestCase) -> str:
    """Name of the plant that a scenario names, else of that which implements its test case; raises `ConfigError`."""
    if spec.kind != "embedded":
        return spec.kind
    own = next((name for name, entry in REGISTRY.own.items() if entry.implements(testcase)), testcase.plant)
    if own is None:
        raise ConfigError(
            f"plant.kind: no embedded plant implements {testcase.name}, those do for {', '.join(_EMBEDDED)}; "
            "give the address of a BOPTEST service (--url, in Python url=), or the test case's FMU (--fmu, fmu=)"
        )
    return own


def choose_plant(spec: PlantSpec, testcase: TestCase, seed: int, comfort: Comfort | None = None) -> ChosenPlant:
    """The plant of a scenario with its validated options; `comfort` takes the place of its own comfort bounds.

    Raises `ConfigError` where it lacks or would ignore something.
    """
    name = plant_name(spec, testcase)
    entry = REGISTRY.find(name)
    for key in (WEATHER, PRICES, UNCERTAINTY, PEOPLE):
        if key not in entry.takes and getattr(spec, key) != PlantSpec.model_fields[key].default:
            raise ConfigError(f"plant.{key}: plant '{name}' of test case '{testcase.name}' has its own; leave it out")
    missing = entry.missing()
    if missing:
        raise ConfigError(f"test case '{testcase.name}': {missing}")
    options = validate(entry.config(), spec.options, f"plant.options of plant '{name}'")
    return ChosenPlant(name, entry, spec, options, testcase, seed, comfort)


def check_surroundings(spec: PlantSpec) -> None:
    """Read the files of weather and prices that a plant is given; raises `WeatherError` or `ConfigError`."""
    _weather(spec)
    _tariff(spec)


def windows_of(spec: PlantSpec, testcase: TestCase) -> tuple[str, ...] | None:
    """Names of the windows of a plant beside start days, None where only it knows them; raises `ConfigError`."""
    names = REGISTRY.find(plant_name(spec, testcase)).windows(spec, testcase)
    return None if names is None else tuple(names)


def boptest_plant(spec: PlantSpec, testcase: TestCase, options: Any, seed: int, testid: str | None = None) -> Plant:
    """The plant behind a service; with `testid` the test that it has already."""
    from thermoforce_mpc.plants.boptest.plant import BoptestPlant, check_token

    check_token(spec.url)
    uncertainty = spec.forecast_uncertainty
    return BoptestPlant(
        spec.url, testcase, forecast_uncertainty=uncertainty, seed=seed, testid=testid, config=patience(spec)
    )


def patience(spec: PlantSpec) -> TransportConfig:
    """How long a service may be away."""
    from boptest_client import TransportConfig

    return TransportConfig(patience_s=60.0 * spec.patience_min)


def _fmu(spec: PlantSpec, testcase: TestCase, options: Any, seed: int) -> Plant:
    from thermoforce_mpc.plants.fmu import FmuPlant

    error, patience_s = _error(spec, seed), 60.0 * spec.patience_min
    return FmuPlant(Path(spec.path or ""), testcase, forecast_error=error, patience_s=patience_s)


def _rooms(spec: PlantSpec, testcase: TestCase, options: Any, seed: int) -> Plant:
    from thermoforce_mpc.plants.rooms import house_of_rooms

    return house_of_rooms(testcase.name, spec.people, _tariff(spec))


def _generated(spec: PlantSpec, testcase: TestCase, options: Any, seed: int) -> Plant:
    from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, generated_house

    return GeneratedHousePlant(generated_house(testcase.name), highly_dynamic=_tariff(spec), people=spec.people)


def _small_office(spec: PlantSpec, testcase: TestCase, options: Any, seed: int) -> Plant:
    from thermoforce_mpc.plants.energyplus.office import SmallOfficePlant

    return SmallOfficePlant(testcase, **_on_engine(spec, seed))


def _energyplus(spec: PlantSpec, testcase: TestCase, options: Any, seed: int) -> Plant:
    from thermoforce_mpc.plants.energyplus.zone import EnergyPlusPlant

    return EnergyPlusPlant(testcase, **_on_engine(spec, seed))


def _on_engine(spec: PlantSpec, seed: int) -> dict[str, Any]:
    patience_s = 60.0 * spec.patience_min
    return {"highly_dynamic": _tariff(spec), "forecast_error": _error(spec, seed), "patience_s": patience_s}


def _emulator(spec: PlantSpec, testcase: TestCase, options: Any, seed: int) -> Plant:
    from thermoforce_mpc.plants.embedded import EmbeddedPlant

    error, tariff = _error(spec, seed), _tariff(spec)
    return EmbeddedPlant(_weather(spec), highly_dynamic=tariff, forecast_error=error, people=spec.people)


def _point_emulator(spec: PlantSpec, testcase: TestCase, options: Any, seed: int) -> Plant:
    from thermoforce_mpc.plants.embedded import PointEmulator
    from thermoforce_mpc.plants.embedded.cases import CASES

    weather = _weather(spec, CASES[testcase.plant or ""].climate)
    error, tariff = _error(spec, seed), _tariff(spec)
    return PointEmulator(testcase, weather, highly_dynamic=tariff, forecast_error=error, people=spec.people)


def emulator_of(testcase: str, weather: Weather, **options: Any) -> Emulator:
    """The emulator of an embedded test case by name, acting through the points of its shipped file.

    Raises `ConfigError` for another test case.
    """
    from thermoforce_mpc.plants.embedded import EmbeddedPlant, PointEmulator
    from thermoforce_mpc.plants.embedded.cases import CASES, HEAT_PUMP
    from thermoforce_mpc.plants.testcases import load_testcase

    if testcase not in CASES:
        raise ConfigError(f"no embedded plant implements '{testcase}'; those do for {', '.join(CASES)}")
    if testcase == HEAT_PUMP.name:
        return EmbeddedPlant(weather, **options)
    return PointEmulator(load_testcase(testcase), weather, **options)


def _error(spec: PlantSpec, seed: int) -> ForecastError | None:
    from thermoforce_mpc.boundary.forecast_error import ForecastError

    return (
        None
        if spec.forecast_uncertainty == "none"
        else ForecastError(spec.forecast_uncertainty, spec.forecast_uncertainty, seed)
    )


def _weather(spec: PlantSpec, climate: SyntheticClimate | None = None) -> Weather:
    from thermoforce_mpc.boundary.weather import MARITIME, load_weather, synthetic_weather

    if spec.weather != "synthetic":
        return load_weather(Path(spec.weather))
    return synthetic_weather(climate=climate or MARITIME)


def _tariff(spec: PlantSpec) -> Tariff | None:
    return tariff_of(Path(spec.prices_file)) if spec.prices_file else None


def tariff_of(path: Path) -> Tariff:
    """The tariff of a file of prices (`boundary.tariffs`) or of a bill (`scenario.bill`); raises `ConfigError`."""
    import numpy as np

    from thermoforce_mpc.boundary.tariffs import tariff_from_file
    from thermoforce_mpc.scenario.bill import SUFFIXES, file_beside, read_bill

    if path.suffix not in SUFFIXES:
        return tariff_from_file(path)
    bill = read_bill(path)
    if bill.energy is None:
        raise ConfigError(f"{path}: energy: a price per kWh, or a file of them: a simulated building has no map")
    number = bill.energy
    of_file = tariff_from_file(file_beside(path, number)) if isinstance(number, str) else None

    def tariff(time_s: Array) -> Array:
        energy = np.full(np.shape(time_s), number) if of_file is None else of_file(time_s)
        return bill.over_year(energy, time_s)

    return tariff


def _of_weather(spec: PlantSpec, testcase: TestCase) -> Collection[str]:
    from thermoforce_mpc.plants.embedded.cases import CASES

    return CASES[testcase.plant or testcase.name].periods


def _weeks(spec: PlantSpec, testcase: TestCase) -> Collection[str]:
    from thermoforce_mpc.plants.drawn_houses import NAMES

    return NAMES


def _of_office(spec: PlantSpec, testcase: TestCase) -> Collection[str]:
    from thermoforce_mpc.plants.energyplus.office import PERIODS

    return PERIODS


def _of_fmu(spec: PlantSpec, testcase: TestCase) -> Collection[str]:
    from thermoforce_mpc.plants.fmu.archive import scenario_days

    return scenario_days(Path(spec.path or ""))


def _without_engine() -> str:
    from thermoforce_mpc.plants.energyplus.engine import is_available

    return "" if is_available() else "it runs on EnergyPlus: pip install 'thermoforce-mpc[energyplus]'"


# Which of them a service's test case has, only the service knows.
_OF_BOPTEST = ("peak_heat_day", "typical_heat_day", "peak_cool_day", "typical_cool_day", "mix_day", "cold_day")
_ON_ENGINE = frozenset({PRICES, UNCERTAINTY})
_EMBEDDED = ("bestest_hydronic_heat_pump", "bestest_hydronic", "bestest_air")
_SURROUNDED = frozenset({WEATHER, PRICES, UNCERTAINTY, PEOPLE})
_OWN = {
    "emulator": PlantEntry(
        "embedded emulator of bestest_hydronic_heat_pump",
        _emulator,
        takes=_SURROUNDED,
        windows=_of_weather,
        implements=lambda testcase: testcase.embedded,
    ),
    "bestest_hydronic": PlantEntry(
        "embedded emulator of bestest_hydronic", _point_emulator, takes=_SURROUNDED, windows=_of_weather
    ),
    "bestest_air": PlantEntry(
        "embedded emulator of bestest_air", _point_emulator, takes=_SURROUNDED, windows=_of_weather
    ),
    "rooms": PlantEntry(
        "drawn house or office of rooms, a valve each, one heat pump (--testcase house:5rooms, office:5rooms)",
        _rooms,
        takes=frozenset({PRICES, PEOPLE}),
        windows=_weeks,
    ),
    "generated": PlantEntry(
        "generated house of one zone, by seed and number (--testcase generated:2026:0)",
        _generated,
        takes=frozenset({PRICES, PEOPLE}),
        windows=_weeks,
    ),
    "energyplus": PlantEntry(
        "a zone on EnergyPlus (--testcase energyplus:heating_chicago), extra [energyplus]",
        _energyplus,
        takes=_ON_ENGINE,
        missing=_without_engine,
        windows=lambda _, testcase: testcase.energyplus.periods if testcase.energyplus else (),
        implements=lambda testcase: testcase.energyplus is not None,
    ),
    "small_office": PlantEntry(
        "an office of five zones on EnergyPlus (--testcase energyplus:small_office), extra [energyplus]",
        _small_office,
        takes=_ON_ENGINE,
        missing=_without_engine,
        windows=_of_office,
    ),
    "boptest": PlantEntry(
        "a BOPTEST service (--url)",
        boptest_plant,
        takes=frozenset({UNCERTAINTY}),
        windows=lambda *_: _OF_BOPTEST,
        attach=lambda spec, testcase, seed, testid: boptest_plant(spec, testcase, None, seed, testid),
    ),
    "fmu": PlantEntry("a test case's FMU (--fmu), extra [fmu]", _fmu, takes=frozenset({UNCERTAINTY}), windows=_of_fmu),
}


def _plugin(name: str, plugin: PlantEntry | Callable[..., Plant]) -> PlantEntry:
    """A plugin's entry, or that of a class or function whose parameters are its options."""
    if isinstance(plugin, PlantEntry):
        return plugin

    def build(spec: PlantSpec, testcase: TestCase, options: Any, seed: int) -> Plant:
        plant: Plant = called(plugin, options, {"testcase": testcase, "seed": seed})
        return plant

    return PlantEntry(first_line(plugin) or name, build, lambda: options_model(plugin, _HANDED))


# What a plugin's class or function is handed, where it has a parameter of the name.
_HANDED = ("testcase", "seed")
REGISTRY: Registry[PlantEntry] = Registry(
    "plant",
    "plants",
    _OWN,
    ConfigError,
    lambda plugin: "" if isinstance(plugin, PlantEntry) else unfit(plugin, _HANDED),
    _plugin,
)
