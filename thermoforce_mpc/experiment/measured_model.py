"""A model from measurements of a building in files, as `tf-mpc identify --data` makes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.identification.probing.operation import MOST_DAYS, telling_part
from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.measurements.map.mapping import load_map
from thermoforce_mpc.measurements.tables.files import check_columns
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.scenario.testcase import TestCase


def check_measurements(file: str | Path, map_file: str | Path, testcase: TestCase | None = None) -> None:
    """Refuse a map that is wrong, or a file without its columns, before any of them is read in full.

    The names of a test case on which the model is to be run, and what its actuators do, have to be those of the map.

    Raises:
        ConfigError: the map is wrong, or does not fit the test case.
        DataError: the file cannot be read, or lacks a column.
    """
    rules = load_map(Path(map_file))
    columns = [column for _, signal in rules.signals() for column in signal.columns]
    check_columns([file], columns, rules.written)
    if testcase is None:
        return
    map_layout, testcase_layout = rules.layout, testcase.layout
    # A model has the zones that an actuator serves.
    served = tuple(name for z, name in enumerate(map_layout.names.zones) if map_layout.actuators_of(z))
    names = replace(map_layout.names, zones=served)
    for kind in ("zones", "actuators", "machines"):
        map_names, testcase_names = getattr(names, kind), getattr(testcase_layout.names, kind)
        if map_names != testcase_names:
            raise ConfigError(
                f"{map_file}: {kind}: it has {', '.join(map_names)}, test case '{testcase.name}' has "
                f"{', '.join(testcase_names)}; give them the names of the test case, in its order"
            )
    for a, name in enumerate(names.actuators):
        if map_layout.mode(a) != testcase_layout.mode(a):
            raise ConfigError(
                f"{map_file}: actuators.{name}.mode is {map_layout.mode(a)}, test case '{testcase.name}' is for "
                f"{testcase_layout.mode(a)}"
            )


def model_of_measurements(
    files: Sequence[str | Path],
    map_file: str | Path,
    *,
    days: float | None = None,
    config: IdentificationConfig | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[ThermalModel, Record]:
    """Identify from measurements, CSV or Parquet `files` and their map; also the part of the record that was used.

    `days`: of longer measurements so many that tell most are used; `say`: told what a user should know.

    Raises:
        ConfigError: the map is wrong; names the key.
        DataError: the measurements cannot be used, or cannot be fitted.
    """
    measured = read_measurements(files, map_file).served()
    summary, names = measured.understood, ", ".join(measured.understood.files)
    say(f"Measurements: {names}\n{summary.begins} to {summary.ends}, step {summary.step_s / 60:g} min")
    for text in summary.doubts_in_words():
        say(f"  {text}")
    record, note = telling_part(measured.record, measured.layout, days=days or MOST_DAYS)
    if note:
        say(note)
    config = config or IdentificationConfig()
    if any(actuator.flow is not None for actuator in measured.map.actuators.values()):
        # Levels by the water's temperature: heat needs more power in warmer water.
        config = config.model_copy(update={"power_curve": True})
    model = identify(
        record,
        layout=measured.layout,
        config=config,
        source=f"measurements of {record.stamps()[0]} to {record.stamps()[-1]} in {names}",
        progress=say,
    )
    notes = tuple(text for text in (note, *summary.beside, *summary.assumed) if text)
    return replace(model, cards=tuple(replace(card, notes=(*notes, *card.notes)) for card in model.cards)), record
