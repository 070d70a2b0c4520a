"""Reader of the REFIT Smart Home release (Firth et al., doi:10.17028/rd.lboro.2070091).

Two files: REFIT_BUILDING_SURVEY.xml says which sensor stands where (RefitXML: Building > Space > Sensor >
TimeSeriesVariable with `id`, `variableType`, `units`; gas under Meter, the weather station under Climate), and
REFIT_TIME_SERIES_VALUES.csv holds 25 million rows of `TimeSeriesVariable/@id`, `dateTime` (ISO, UTC), `data`, which are
streamed. A home is its living room's air temperature, its gas meter as what acted, and the station's weather.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from benchmarks.factual.homes import Home
from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.files import file_sha256

SURVEY, VALUES = "REFIT_BUILDING_SURVEY.xml", "REFIT_TIME_SERIES_VALUES.csv"
_ID, _TIME, _DATA = "TimeSeriesVariable/@id", "dateTime", "data"
_STEP_S = 1800
_ROWS = 500_000
# A radiator colder than this counts as off: else its reading would tell the room's temperature, which is forecast.
_RADIATOR_OFF_C = 30.0


@dataclass(frozen=True)
class _Variable:
    """A recorded quantity: what it is (`variableType`) and the elements that hold it, outermost first."""

    id: str
    kind: str
    building: str
    place: str
    above: tuple[str, ...]


def refit_homes(
    folder: Path, say: Callable[[str], None] = lambda line: None, *, rows_at_once: int = _ROWS
) -> list[Home]:
    """The homes of the release that have a living-room temperature and a gas meter or a radiator sensor.

    `rows_at_once`: of the values, which are streamed.

    Raises:
        DataError: a file is missing, is not XML, lacks a column, or holds no home; the message names the file.
    """
    survey, values = folder / SURVEY, folder / VALUES
    for path in (survey, values):
        if not path.is_file():
            raise DataError(f"{path} is missing: the REFIT release has {SURVEY} and {VALUES} in one folder")
    variables = _variables(survey)
    outdoor = [v for v in variables if "Climate" in v.above and "temperature" in v.kind]
    sun = [v for v in variables if "Climate" in v.above and ("solar" in v.kind or "irradia" in v.kind)]
    if not outdoor:
        raise DataError(f"{survey}: no air temperature under Climate: the homes have no weather")
    sun = [v for v in sun if "horizontal" in v.kind or "global" in v.kind] or sun
    wanted = [*outdoor, *sun]
    rooms: dict[str, list[_Variable]] = {}
    meters: dict[str, list[_Variable]] = {}
    for building in dict.fromkeys(v.building for v in variables if v.building):
        own = [v for v in variables if v.building == building]
        air = [v for v in own if v.kind == "air temperature" and _living(v.place)]
        gas = [v for v in own if "gas" in v.kind]
        radiators = [v for v in own if "surface temperature" in v.kind and _living(v.place)]
        if air and (gas or radiators):
            rooms[building], meters[building] = air, gas or radiators
            wanted += [*air, *(gas or radiators)]
        else:
            say(f"{building}: left out, no {'meter or radiator' if air else 'living-room temperature'} in {SURVEY}")
    if not rooms:
        raise DataError(f"{survey}: no building has a living-room air temperature and a gas meter or radiator sensor")
    # What acts belongs to the step it falls into; volumes of gas are summed over it.
    of_steps = {v.id: "gas" in v.kind for found in meters.values() for v in found}
    binned = _binned(values, {v.id for v in wanted}, of_steps, rows_at_once, say)
    start = min(min(bins) for bins in binned.values())
    stop = max(max(bins) for bins in binned.values())
    n = stop - start + 1

    def series(candidates: list[_Variable]) -> Array:
        """The best covered of `candidates` on the common clock (n,)."""
        bins = max((binned.get(v.id, {}) for v in candidates), key=len, default={})
        out = np.full(n, np.nan)
        for index, (total, count) in bins.items():
            out[index - start] = total / count
        return out

    origin = pd.Timestamp(start * _STEP_S, unit="s", tz="UTC")
    new_year = pd.Timestamp(year=origin.year, month=1, day=1, tz="UTC")
    time_s = (origin - new_year).total_seconds() + _STEP_S * np.arange(n, dtype=np.float64)
    T_out, solar = series(outdoor), series(sun) if sun else np.zeros(n)
    unknown = np.full(n - 1, np.nan)
    source = {path.name: file_sha256(path) for path in (survey, values)}
    homes = []
    for building, air in rooms.items():
        room, meter = series(air), series(meters[building])[:-1]
        inside = np.flatnonzero(np.isfinite(room))
        if not inside.size or not np.isfinite(meter).any():
            say(f"{building}: left out, no values in {VALUES}")
            continue
        if "gas" not in meters[building][0].kind:
            meter = np.maximum(meter - _RADIATOR_OFF_C, 0.0)
        # The home's own stretch: sensors were placed at different times.
        a, b = int(inside[0]), int(inside[-1])
        record = Record(time_s, room, T_out, solar, unknown, unknown, unknown, origin=new_year).slice(a, b)
        homes.append(Home(building, "REFIT", record, {meters[building][0].kind: meter[a:b]}, source=source))
    return homes


def _living(place: str) -> bool:
    return "living" in place or "lounge" in place or "sitting" in place


def _variables(survey: Path) -> list[_Variable]:
    try:
        root = ElementTree.parse(survey).getroot()
    except ElementTree.ParseError as error:
        raise DataError(f"{survey}: not an XML file ({error})") from error
    return list(_walk(root, "", "", ()))


def _walk(node: ElementTree.Element, building: str, place: str, above: tuple[str, ...]) -> Iterator[_Variable]:
    tag = node.tag.rpartition("}")[2]
    building = node.get("id", building) if tag == "Building" else building
    place = node.get("roomType", place).lower() if tag == "Space" else place
    if tag == "TimeSeriesVariable" and node.get("id"):
        yield _Variable(node.get("id", ""), node.get("variableType", "").lower(), building, place, above)
    for child in node:
        yield from _walk(child, building, place, (*above, tag))


def _binned(
    path: Path, wanted: set[str], of_steps: Mapping[str, bool], rows_at_once: int, say: Callable[[str], None]
) -> dict[str, dict[int, tuple[float, float]]]:
    """Sum and count of the readings of each variable by half hour since 1970, streamed.

    A sampled quantity belongs to the nearest boundary, one `of_steps` to the step it falls into; where that says True,
    it is summed over the step and the count is 1.
    """
    found: dict[str, dict[int, tuple[float, float]]] = defaultdict(dict)
    read = 0
    try:
        with pd.read_csv(path, usecols=[_ID, _TIME, _DATA], chunksize=rows_at_once) as chunks:
            for chunk in chunks:
                read += len(chunk)
                rows = chunk[chunk[_ID].isin(wanted)]
                if not rows.empty:
                    _add(found, rows, of_steps, path)
                say(f"{path.name}: {read} rows read")
    except ValueError as error:
        raise DataError(f"{path}: expected the columns {_ID}, {_TIME}, {_DATA} ({error})") from error
    if not found:
        raise DataError(f"{path}: no row belongs to a sensor of {SURVEY}; are the two files of one release?")
    return found


def _add(
    found: dict[str, dict[int, tuple[float, float]]], rows: pd.DataFrame, of_steps: Mapping[str, bool], path: Path
) -> None:
    at = pd.to_datetime(rows[_TIME], utc=True, format="ISO8601", errors="coerce")
    value = pd.to_numeric(rows[_DATA], errors="coerce")
    if at.isna().any():
        row = int(rows.index[at.isna()][0])
        raise DataError(f"{path}: row {row + 2}: '{rows[_TIME][row]}' is not a time stamp")
    seconds = np.asarray((at - pd.Timestamp(0, tz="UTC")).dt.total_seconds(), dtype=np.float64)
    kept = value.notna().to_numpy()
    flow = rows[_ID].isin(of_steps).to_numpy()
    bins = np.where(flow, np.floor(seconds / _STEP_S), np.round(seconds / _STEP_S)).astype(int)
    table = pd.DataFrame({"id": rows[_ID].to_numpy(), "bin": bins, "value": value.to_numpy()})[kept]
    sums = table.groupby(["id", "bin"])["value"].agg(["sum", "count"])
    for (name, index), total, count in sums.itertuples():
        before, readings = found[name].get(index, (0.0, 0.0))
        found[name][int(index)] = (before + total, 1.0 if of_steps.get(name) else readings + count)
