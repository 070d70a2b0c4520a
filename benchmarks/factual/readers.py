"""Readers of measured homes: the Mons house, the test box, the REFIT release; the layouts are recognised by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.factual.homes import Home
from benchmarks.factual.refit import VALUES, refit_homes
from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.data.dataframes import column
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.measurements.load import read_measurements

MONS, BOX = "mons_house_30min.csv.gz", "armadillo_H2_30min.csv"
MONS_ROOMS = {
    "kitchen": "T1_degC", "living room": "T2_degC", "laundry": "T3_degC", "office": "T4_degC", "bathroom": "T5_degC",
    "north side, outdoors": "T6_degC", "ironing room": "T7_degC", "bedroom": "T8_degC", "parents": "T9_degC",
}  # fmt: skip
"""Columns of the nine rooms (Candanedo, Feldheim and Deramaix 2017); the sixth hangs outside on the north side."""

# Other meters than the heater, each of whose energy ends as heat in some room.
_OTHER_METERS = {"appliances": "appliances_Wh", "lights": "lights_Wh", "hot water": "hot_water_Wh"}
_MONS_LATITUDE, _MONS_LONGITUDE, _MONS_TIMEZONE_H = 50.45, 3.95, 1.0
# Weather is interpolated across gaps of at most this many steps; the temperature itself never is.
_WEATHER_GAP_STEPS = 6

Say = Callable[[str], None]


def read_homes(folder: Path, *, all_meters: bool = False, say: Say = lambda line: None) -> list[Home]:
    """All homes in `folder`, by the layouts known here.

    Args:
        folder: holds `mons_house_30min.csv.gz`, `armadillo_H2_30min.csv` or the two files of the REFIT release.
        all_meters: also offer the meters of other heat (appliances, lights, hot water).
        say: callback for progress lines.

    Raises:
        DataError: none of the files is there, or one is not as expected.
    """
    homes: list[Home] = []
    if (folder / MONS).is_file():
        homes += mons_homes(folder / MONS, all_meters=all_meters)
    if (folder / BOX).is_file():
        homes.append(box_home(folder / BOX))
    if (folder / VALUES).is_file():
        homes += refit_homes(folder, say)
    if not homes:
        there = ", ".join(sorted(path.name for path in folder.iterdir())[:8]) or "nothing"
        raise DataError(
            f"--records {folder}: none of {MONS}, {BOX}, {VALUES} is there (there is {there}); for your own table give "
            "--data FILE --map map.yaml"
        )
    return homes


def mapped_homes(files: Sequence[str | Path], map: str | Path) -> list[Home]:
    """Each zone of your own measurements; what acts are the levels of the actuators that serve it, or else of all.

    Raises:
        ConfigError: the map is wrong.
        DataError: a file cannot be used, or no level, heat or power that heats or cools only was mapped.
    """
    measured = read_measurements([str(file) for file in files], map)
    layout, record = measured.layout, measured.record
    source = {Path(file).name: file_sha256(Path(file)) for file in measured.understood.files}
    homes = []
    for z, zone in enumerate(layout.names.zones):
        acting = [a for a in layout.actuators_of(z) or range(len(layout.home)) if layout.u_min[a] >= 0.0]
        meters = {layout.names.actuators[a]: record.u[a] for a in acting if layout.signs[a] == layout.signs[acting[0]]}
        if not any(np.isfinite(values).any() for values in meters.values()):
            raise DataError(
                f"{map}: no level, heat or power was measured for zone '{zone}': map what heats or cools it"
            )
        homes.append(Home(zone, "mapped", record.part(z, acting[:1]), meters, layout.signs[acting[0]], source))
    return homes


def mons_homes(path: Path, *, all_meters: bool = False) -> list[Home]:
    """The nine rooms of the Mons house; what acts is the electric heater of the house."""
    frame, time_s, outdoor, solar = mons_table(path)
    nothing = np.full(time_s.size - 1, np.nan)
    meters = {"heater": column(frame, "heater_Wh", path.name)[:-1]}
    if all_meters:
        meters |= {name: column(frame, key, path.name)[:-1] for name, key in _OTHER_METERS.items()}
    source = {path.name: file_sha256(path)}
    homes = []
    for room, key in MONS_ROOMS.items():
        T = column(frame, key, path.name)
        record = Record(time_s, T, outdoor, solar, nothing, nothing, nothing, origin=pd.Timestamp("2016-01-01"))
        homes.append(Home(f"Mons {room}", "Mons", record, meters, source=source))
    return homes


def mons_table(path: Path) -> tuple[pd.DataFrame, Array, Array, Array]:
    """Table of the Mons house, seconds since 1 January 2016, outdoor temperature °C and irradiance W/m², each (n,).

    Sunlight was not measured; it is estimated from humidity and NaN on days without humidity.
    """
    from thermoforce_mpc.boundary.weather.solar import sun_position, sunlight_from_humidity

    frame = pd.read_csv(path, parse_dates=["time"]).set_index("time").asfreq("30min").reset_index()
    time_s: Array = np.asarray((frame["time"] - pd.Timestamp("2016-01-01")).dt.total_seconds(), dtype=np.float64)
    sun = sun_position(time_s, _MONS_LATITUDE, _MONS_LONGITUDE, _MONS_TIMEZONE_H)
    weather = frame[["T_out_degC", "RH_out_pct"]].interpolate(limit=_WEATHER_GAP_STEPS, limit_area="inside")
    outdoor, humidity = weather["T_out_degC"].to_numpy(float), weather["RH_out_pct"].to_numpy(float) / 100.0
    return frame, time_s, outdoor, sunlight_from_humidity(time_s, humidity, sun)


def box_home(path: Path) -> Home:
    """The experimental test box (pySIP's Armadillo record); its times have no date."""
    frame = pd.read_csv(path)
    time_s, T, T_out, solar, power = (
        column(frame, key, path.name) for key in ("Time", "T_int", "T_ext", "I_sol", "P_hea")
    )
    nothing = np.full(time_s.size - 1, np.nan)
    record = Record(time_s, T, T_out, solar, nothing, nothing, nothing)
    return Home("test box", "box", record, {"heater": power[:-1]}, source={path.name: file_sha256(path)})
