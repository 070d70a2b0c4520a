"""`tf-mpc bench records`: faults put into records of houses drawn anew, and what the checks of a record say of them.

A fault is found where there is a remark, and rightly named where a remark has its name and none another. Clean records
must be left alone. Where a folder of measured buildings is given, faults of stamps and units are put into them too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.cases import run_all
from benchmarks.measured_rooms.records import MeasuredRecord, found_records
from benchmarks.records.drawing import OPERATIONS, Drawn, Operation, drawn
from benchmarks.records.spoiling import faults
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import Record
from thermoforce_mpc.data.limits import LOAD_W_PER_M2
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.measurements.checks import remarks
from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.plants.random_houses import generated_house

_FOUND, _FALSE = 0.95, 0.02
_QUICK_HOUSES = 3
CLEAN, NEIGHBOURS, NIGHT = "clean", "neighbours left out", "night with a zero offset"
# Records of measured buildings that are as they should be; their temperatures are read at the stamps.
_SOUND = ("all19", "all23e")
_ZERO_OFFSET_W_M2 = (1.5, 15.0)

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A house by its number and operation, or a measured record in its folder."""

    seed: int
    number: int
    operation: Operation = "probing"
    measured: MeasuredRecord | None = None
    folder: Path | None = None


@dataclass(frozen=True)
class Answer:
    """What was said of one record with one fault: the kinds of its remarks; `right`: that of the fault and no other."""

    building: str
    operation: str
    emitter: str
    fault: str
    size: str
    kinds: tuple[str, ...]

    @property
    def right(self) -> bool:
        """Whether the fault, and nothing else, was named."""
        return set(self.kinds) == {self.fault}


def run_records_bench(
    *,
    seed: int = 1,
    houses: int = 40,
    engine: Engine,
    records: Sequence[Path] = (),
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Spoil the records of `houses` houses of each operation of population `seed`, and those in the folders `records`.

    Raises:
        InputError: no houses.
        DataError: a folder holds none of the measured records.
        PlantError: a plant failed.
    """
    if houses < 1:
        raise InputError(f"{houses} houses: expected at least one")
    numbers = range(min(houses, _QUICK_HOUSES) if quick else houses)
    cases = [Case(seed, n, operation) for operation in OPERATIONS for n in numbers]
    measured = found_records(records) if records else []
    cases += [Case(seed, 0, measured=one, folder=folder) for one, folder in measured if one.name in _SOUND]

    def told(done: int, found: list[Answer]) -> None:
        right = sum(answer.right for answer in found if answer.fault not in (CLEAN, NIGHT))
        progress(f"{done} of {len(cases)}: {found[0].building}, {right} of {len(found) - 1} faults rightly named")

    answers = [answer for found in run_all(asked, cases, engine, told) for answer in found]
    return results_json("records", summary(answers), targets(answers)) | {
        "answers": [answer.__dict__ | {"right": answer.right} for answer in answers]
    }


def asked(case: Case) -> list[Answer]:
    """What the checks say of the clean record of a case and of each fault in it."""
    if case.measured is not None and case.folder is not None:
        found = case.measured.read(case.folder)
        record = found.record
        clean = Drawn(case.measured.name, "rooms", record, found.layout, np.full_like(record.u, np.nan))
        operation = "measured"
    else:
        clean = drawn(case.operation, case.seed, case.number)
        operation = case.operation
    emitter = generated_house(clean.name).emitter if clean.name.startswith("generated:") else operation
    told = (clean.name, operation, emitter)
    whole = _beside(clean, clean.layout.names.zones) if operation == "rooms" else ()
    answers = [Answer(*told, CLEAN, "", (*_kinds(clean, clean.record), *whole))]
    for k, fault in enumerate(faults()):
        rng = np.random.default_rng([case.seed, case.number, k])
        if operation == "measured" and fault.kind in ("level is no level", "meter holds another load"):
            continue  # their level is made from the meter
        spoiled = fault.spoil(clean, rng)
        if spoiled is not None:
            answers.append(Answer(*told, fault.kind, fault.size, _kinds(clean, spoiled)))
    if operation == "rooms":
        answers.append(Answer(*told, NEIGHBOURS, "", _beside(clean, clean.layout.names.zones[:1])))
    return [*answers, _dark(clean, np.random.default_rng([case.seed, case.number]))]


def summary(answers: Sequence[Answer]) -> list[Row]:
    """Table rows by fault and size; those of stamps by emitter too, since what heats slowly hardly tells of a step."""

    def key(a: Answer) -> tuple[str, str, str]:
        return a.fault, a.size, a.emitter if a.fault.startswith("stamps") else "all"

    rows = []
    for fault, size, emitter in sorted(dict.fromkeys(map(key, answers)), key=lambda key: key[0] != CLEAN):
        of = [a for a in answers if key(a) == (fault, size, emitter)]
        clean = fault in (CLEAN, NIGHT)
        rows.append(
            {
                "fault": fault,
                "size": size,
                "of": emitter,
                "records": len(of),
                "found_percent": 100.0 * float(np.mean([bool(a.kinds) for a in of])),
                "right_percent": None if clean else 100.0 * float(np.mean([a.right for a in of])),
            }
        )
    return rows


def targets(answers: Sequence[Answer]) -> list[Target]:
    """Of each class of fault over all sizes and operations, and of what is clean."""
    found = []
    for fault in dict.fromkeys(a.fault for a in answers):
        of = [a for a in answers if a.fault == fault]
        if fault in (CLEAN, NIGHT):
            false = float(np.mean([bool(a.kinds) for a in of]))
            found.append(Target(f"{fault}: share of {len(of)} records with a remark", false, _FALSE))
        else:
            right = float(np.mean([a.right for a in of]))
            found.append(Target(f"{fault}: share of {len(of)} rightly named", right, _FOUND, "at least"))
    return found


def _kinds(clean: Drawn, record: Record) -> tuple[str, ...]:
    """Kinds of the remarks on a record of the building of `clean`; loads beyond the floor area are refused at once."""
    area = float(np.sum(clean.layout.floor_area_m2))
    loads = np.concatenate([record.power_W.ravel(), record.heat_W.ravel()])
    loads = np.abs(loads[np.isfinite(loads)])
    beyond = bool(np.isfinite(area) and loads.size and (loads > LOAD_W_PER_M2 * area).mean() > 0.1)
    kinds = dict.fromkeys(remark.kind for remark in remarks(record, clean.layout))
    return tuple(kinds) or (("unit of power",) if beyond else ())


def _beside(clean: Drawn, zones: Sequence[str]) -> tuple[str, ...]:
    """What is said of rooms outside the map where a table holds all rooms of a house and the map names `zones`."""
    names = clean.layout.names.zones
    columns = {f"T_{zone}": clean.record.T_zone_C[z] for z, zone in enumerate(names)}
    rules = {
        "outdoor": "T_out",
        "zones": {zone: {"temperature": f"T_{zone}"} for zone in zones},
        "actuators": {"valve": {"zone": zones[0], "level": "u"}},
    }
    return (NEIGHBOURS,) if read_measurements(_table(clean.record, columns), rules).understood.beside else ()


def _dark(clean: Drawn, rng: np.random.Generator) -> Answer:
    """An irradiance whose sensor reads a steady few W/m² at night, which is no fault."""
    offset = np.round(rng.uniform(*_ZERO_OFFSET_W_M2), 1)
    record = replace(clean.record, solar_W_m2=np.maximum(clean.record.solar_W_m2, offset))
    rules = {"outdoor": "T_out", "sun": "sun", "zones": {"room": {"temperature": "T"}}}
    found = read_measurements(_table(record, {"T": record.T_zone_C[0]}), rules)
    flags = [flag.rule for signal in found.understood.signals if signal.key == "sun" for flag in signal.flags]
    return Answer(clean.name, clean.operation, clean.operation, NIGHT, "", tuple(flags))


def _table(record: Record, columns: dict[str, Any]) -> pd.DataFrame:
    at = pd.Timestamp("2025-01-01") + pd.to_timedelta(record.time_s, unit="s")
    u = np.append(record.u[0], np.nan)
    return pd.DataFrame({**columns, "T_out": record.T_out_C, "sun": record.solar_W_m2, "u": u}, index=at)
