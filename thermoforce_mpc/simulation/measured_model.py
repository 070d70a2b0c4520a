"""A model from measurements of a building in files, as `tf-mpc identify --data` makes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from thermoforce_mpc.data import Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.operating import MOST_DAYS, telling_part
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.model.thermal_model import ThermalModel


def model_of_measurements(
    files: Sequence[str | Path],
    map_file: str | Path,
    *,
    days: float | None = None,
    config: IdentificationConfig | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[ThermalModel, Record]:
    """Identify from measurements; also the part of the record that was used.

    Args:
        files: CSV or Parquet files.
        map_file: their map.
        days: of longer measurements so many that tell most are used, by default `operating.MOST_DAYS`.
        config: options of the identification.
        say: callback for what a user should know.

    Raises:
        ConfigError: the map is wrong; names the key.
        DataError: the measurements cannot be used, or cannot be fitted.
    """
    measured = read_measurements(files, map_file).served()
    known = measured.understood
    say(f"Measurements: {', '.join(known.files)}\n{known.begins} to {known.ends}, step {known.step_s / 60:g} min")
    record, note = telling_part(measured.record, measured.layout, days=days or MOST_DAYS)
    if note:
        say(note)
    model = identify(
        record,
        layout=measured.layout,
        config=config,
        source=f"measurements of {record.stamps()[0]} to {record.stamps()[-1]} in {', '.join(known.files)}",
        progress=say,
    )
    notes = tuple(text for text in (note, *known.assumed) if text)
    return replace(model, cards=tuple(replace(card, notes=(*notes, *card.notes)) for card in model.cards)), record
