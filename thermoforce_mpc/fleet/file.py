"""The YAML file of a fleet: which buildings, and what is run on them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from thermoforce_mpc.comparison.cells import ManyRuns, Variant
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.experiment.measured_model import check_measurements
from thermoforce_mpc.files import read_bounded
from thermoforce_mpc.plants.random_houses import draw_house
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.settings import StrictModel, find_config, read_yaml, suggestion, validate
from thermoforce_mpc.scenario.testcase import Price

# A thermostat on a wall reacts within minutes; at the step of the plans it overshoots and is too easy to beat.
_THERMOSTAT_STEP_S = 300.0
# Keys of a scenario, and those of a fleet from which every run has them.
_ELSEWHERE = {"testcase": "buildings", "period": "windows", "price": "prices", "days": "days", "seed": "seeds",
              "controller": "variants", "baselines": "variants"}  # fmt: skip


class Generated(StrictModel):
    """Generated houses of one zone: numbers `first` to `first + count − 1` of the population `seed`."""

    seed: int = Field(ge=0, lt=10**9, description="population; `tf-mpc bench buildings` reports 2026")
    count: int = Field(ge=1, le=10**7, description="number of houses")
    first: int = Field(0, ge=0, lt=10**8, description="number of the first")


class Rooms(StrictModel):
    """Houses of rooms with a valve each: seeds `first_seed` to `first_seed + count − 1`."""

    rooms: int = Field(ge=1, le=30, description="rooms of each house")
    count: int = Field(ge=1, le=10**7, description="number of houses")
    first_seed: int = Field(1, ge=0, lt=10**8, description="seed of the first")


class BuildingSource(StrictModel):
    """Where buildings come from; exactly one key."""

    generated: Generated | None = Field(None, description="generated houses of one zone")
    rooms: Rooms | None = Field(None, description="houses of rooms")
    testcase: str | None = Field(None, description="one test case: a name (see `tf-mpc testcases`) or YAML file")
    table: str | None = Field(
        None,
        description="CSV file, one building a row: name; testcase, and optionally model (a saved model's folder), "
        "weather, url, fmu; or record and map (measurements and their map), with a test case to run it on or without; "
        "relative paths start at the table's folder",
    )

    @model_validator(mode="after")
    def _has_one_key(self) -> BuildingSource:
        keys = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(keys) != 1:
            raise ValueError(f"needs exactly one of {', '.join(type(self).model_fields)}; found {keys or 'none'}")
        return self


class FleetFile(ManyRuns):
    """Buildings, and windows × tariffs × variants × seeds that are run on each."""

    buildings: tuple[BuildingSource, ...] = Field(min_length=1, description="where buildings come from")
    windows: tuple[str, ...] = Field(
        ("cold_week", "sunny_week"), min_length=1, description="windows that all buildings have, or start days"
    )
    prices: tuple[Price, ...] = Field(("constant",), min_length=1, description="tariffs")
    variants: dict[str, Variant] = Field(
        default_factory=lambda: {
            "thermoforce_mpc": Variant(controller="thermoforce_mpc"),
            "thermostat": Variant(controller="thermostat", options={"step_s": _THERMOSTAT_STEP_S}),
            "native": Variant(controller="native"),
        },
        min_length=1,
        description="controllers with options; by default ours, an on/off thermostat of 5 min, and the building's own",
    )
    reference: str = Field("thermostat", description="variant that savings are counted against")
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = Field(
        (1,), min_length=1, description="seeds of probing, training and forecast errors"
    )
    days: float = Field(7.0, gt=0, le=120, description="scored days of a window")
    trajectories: bool = Field(False, description="keep every run's trajectory too, as Parquet")
    scenario: dict[str, Any] = Field(default_factory=dict, description="any keys of a scenario, for all runs")

    @field_validator("scenario")
    @classmethod
    def _of_all_runs(cls, value: dict[str, Any]) -> dict[str, Any]:
        for key in value:
            if key in _ELSEWHERE:
                raise ValueError(f"{key}: has a key of its own in a fleet, which would replace it: {_ELSEWHERE[key]}")
        return value

    @model_validator(mode="after")
    def _known_reference(self) -> FleetFile:
        if self.reference not in self.variants:
            raise ValueError(f"reference: '{self.reference}' is not among the variants {', '.join(self.variants)}")
        return self


def load_fleet(name: str) -> tuple[FleetFile, Path]:
    """Read a fleet file, given by path or shipped name, and where it is; raises `ConfigError`."""
    path = find_config("fleets", name)
    return validate(FleetFile, read_yaml(path), str(path)), path


_COLUMNS = ("name", "testcase", "model", "record", "map", "weather", "url", "fmu")
_MOST_BYTES = 50_000_000


@dataclass(frozen=True)
class FleetBuilding:
    """A building of a fleet: `name`, once in it, and what of its scenario is its own.

    `source`: kind of source. `emitter`, `machine`, `mass`: what it is, '' where that is not known. `record`: files of
    its measurements and of their map, from which its model is identified; `no_model`: why that gave none. Without a
    test case it is not run.
    """

    name: str
    source: str
    scenario: Mapping[str, Any]
    emitter: str = ""
    machine: str = ""
    mass: str = ""
    area_m2: float = field(default=float("nan"))
    description: str = ""
    record: tuple[str, str] | None = None
    no_model: str = ""

    @property
    def runs(self) -> bool:
        """Whether there is a plant to run it on."""
        return "testcase" in self.scenario


def buildings_of(file: FleetFile, path: Path) -> list[FleetBuilding]:
    """All buildings of the fleet file at `path`; raises `ConfigError` naming file and row."""
    buildings: dict[str, FleetBuilding] = {}
    for number, source in enumerate(file.buildings):
        for building in _from_source(source, path, f"{path}: buildings.{number}"):
            if building.name in buildings:
                raise ConfigError(f"{path}: buildings.{number}: '{building.name}' is in the fleet twice")
            buildings[building.name] = building
    return list(buildings.values())


def _from_source(source: BuildingSource, path: Path, where: str) -> Iterator[FleetBuilding]:
    if (drawn := source.generated) is not None:
        for index in range(drawn.first, drawn.first + drawn.count):
            house = draw_house(drawn.seed, index)
            name, of = f"generated:{house.seed}:{index}", (house.emitter, house.machine, house.mass)
            yield FleetBuilding(name, "generated", {"testcase": name}, *of, house.floor_area_m2, house.words)
    elif (rooms := source.rooms) is not None:
        for seed in range(rooms.first_seed, rooms.first_seed + rooms.count):
            name = f"house:{rooms.rooms}rooms:{seed}"
            yield _from_testcase(name, "rooms", {"testcase": name})
    elif source.testcase is not None:
        try:
            yield _from_testcase(source.testcase, "testcase", {"testcase": source.testcase})
        except ConfigError as error:
            raise ConfigError(f"{where}.testcase: {error}") from error
    elif source.table is not None:
        yield from _from_table(path.parent / Path(source.table).expanduser())


def _from_testcase(name: str, source: str, scenario: Mapping[str, Any]) -> FleetBuilding:
    testcase = load_testcase(str(scenario["testcase"]))
    return FleetBuilding(name, source, scenario, area_m2=testcase.area_m2, description=testcase.description)


def _from_table(table: Path) -> Iterator[FleetBuilding]:
    try:
        text = read_bounded(table, _MOST_BYTES, ConfigError).decode("utf-8-sig")
        reader = csv.DictReader(io.StringIO(text))
        columns, rows = reader.fieldnames or [], [(reader.line_num, row) for row in reader]
    except UnicodeDecodeError as error:
        raise ConfigError(f"{table}: is not UTF-8 ({error})") from error
    except csv.Error as error:
        raise ConfigError(f"{table}: is not CSV ({error})") from error
    if len(set(columns)) < len(columns):
        raise ConfigError(f"{table}: a column is given twice; found {', '.join(columns)}")
    for column in columns:
        if column not in _COLUMNS:
            raise ConfigError(
                f"{table}: column '{column}' is not known{suggestion(column, _COLUMNS)}; known: {', '.join(_COLUMNS)}"
            )
    if "name" not in columns or not {"testcase", "record"} & set(columns):
        raise ConfigError(f"{table}: needs the columns name and testcase, or name, record and map")
    if not rows:
        raise ConfigError(f"{table}: has no buildings")
    for line, row in rows:
        cells = {key: (value or "").strip() for key, value in row.items() if key is not None}
        if None in row or not cells["name"] or not (cells.get("testcase") or cells.get("record")):
            problem = "needs a name, a test case or record, and no more values than columns"
            raise ConfigError(f"{table}: line {line}: {problem}")
        try:
            yield _from_row(cells, table.parent)
        except (ConfigError, DataError) as error:
            raise ConfigError(f"{table}: line {line}: {error}") from error


def _from_row(cells: Mapping[str, str], folder: Path) -> FleetBuilding:
    def path(text: str) -> str:
        return str(folder / Path(text).expanduser())

    record, testcase = None, cells.get("testcase", "")
    if testcase.endswith((".yaml", ".yml")):
        testcase = path(testcase)
    if cells.get("record") or cells.get("map"):
        if not (cells.get("record") and cells.get("map")) or cells.get("model"):
            raise ConfigError("record and map go together, and without model")
        record = path(cells["record"]), path(cells["map"])
        for file in record:
            if not Path(file).is_file():
                raise ConfigError(f"{file}: not a file")
        check_measurements(*record, load_testcase(testcase) if testcase else None)
    if not testcase:
        return FleetBuilding(cells["name"], "record", {}, record=record)
    scenario: dict[str, Any] = {"testcase": testcase}
    if cells.get("model"):
        scenario["identification"] = {"model": path(cells["model"])}
    plant: dict[str, Any] = {}
    if cells.get("url") and cells.get("fmu"):
        raise ConfigError("url and fmu are two plants; give one")
    if cells.get("url"):
        plant = {"kind": "boptest", "url": cells["url"]}
    if cells.get("fmu"):
        plant = {"kind": "fmu", "path": path(cells["fmu"])}
    if cells.get("weather"):
        plant["weather"] = cells["weather"] if cells["weather"] == "synthetic" else path(cells["weather"])
    if plant:
        scenario["plant"] = plant
    return replace(_from_testcase(cells["name"], "table", scenario), record=record)
