"""Tables as programs export them: `tf-mpc data map` takes each for what it is, and its map reads the right values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import thermoforce_mpc as tf
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.map.starting_map import starting_map

ZONE = "Europe/Berlin"
N = 4 * 96


def house() -> pd.DataFrame:
    """Four days of two rooms with valves, weather, a machine; every 15 min, in UTC."""
    at = pd.date_range("2026-01-12", periods=N, freq="15min", tz="UTC")
    hour = np.arange(N) / 4.0
    out = np.round(3 + 4 * np.sin((hour - 9) / 12 * np.pi) + np.sin(hour / 31), 1)
    living = np.round(21 + np.sin(hour / 4) + 0.3 * np.sin(hour), 1)
    bath = np.round(22.5 + 0.8 * np.cos(hour / 5), 1)
    valve = np.where((np.arange(N) // 13) % 3 == 0, 100.0, np.where((np.arange(N) // 13) % 3 == 1, 40.0, 0.0))
    bath_valve = np.roll(valve, 7)
    power = np.round(600 + 9.0 * (valve + bath_valve) + 5 * np.sin(hour))
    return pd.DataFrame(
        {"living": living, "bath": bath, "out": out, "v_living": valve, "v_bath": bath_valve, "power": power}, index=at
    )


HOUSE = house()
ENTITIES = {
    "living": "sensor.living_temperature",
    "bath": "sensor.bath_temperature",
    "out": "sensor.outdoor_temperature",
    "v_living": "sensor.living_valve_position",
    "v_bath": "sensor.bath_valve_position",
    "power": "sensor.heat_pump_power",
}


def local(form: str) -> pd.Series:
    return pd.Series(HOUSE.index.tz_convert(ZONE).strftime(form))


def ha_history(folder: Path) -> list[Path]:
    """On change, with a restart and words that are no readings."""
    parts = []
    for name, entity in ENTITIES.items():
        x = HOUSE[name]
        x = x[x.diff() != 0]
        stamps = x.index.strftime("%Y-%m-%dT%H:%M:%S.%f").str[:-3] + "Z"
        parts.append(pd.DataFrame({"entity_id": entity, "state": x.astype(str).to_numpy(), "last_changed": stamps}))
    gone = pd.DataFrame(
        {
            "entity_id": ["binary_sensor.bath_window"] * 2,
            "state": ["on", "unavailable"],
            "last_changed": ["2026-01-12T08:00:00.000Z", "2026-01-12T09:00:00.000Z"],
        }
    )
    pd.concat([*parts, gone]).to_csv(folder / "history.csv", index=False)
    return [folder / "history.csv"]


def ha_statistics(folder: Path) -> list[Path]:
    parts = []
    for name, entity in ENTITIES.items():
        x = HOUSE[name].to_numpy()
        start = HOUSE.index.strftime("%Y-%m-%d %H:%M:%S+00:00")
        parts.append(pd.DataFrame({"statistic_id": entity, "start": start, "mean": x, "min": x - 0.1, "max": x + 0.1}))
    total = 900 + np.cumsum(HOUSE["power"].to_numpy()) / 4000
    counter = {"statistic_id": "sensor.heat_pump_energy", "start": start, "state": total, "sum": total - 900}
    pd.concat([*parts, pd.DataFrame(counter)]).sort_values("start", kind="stable").to_csv(folder / "s.csv", index=False)
    return [folder / "s.csv"]


def influx(folder: Path) -> list[Path]:
    lines = []
    for k, (name, entity) in enumerate(ENTITIES.items()):
        if k in (0, 3):  # another table begins with its annotations
            lines += [
                "#group,false,false,true,true,false,false,true,true,true",
                "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double" + ",string" * 3,
                "#default,_result,,,,,,,,",
                ",result,table,_start,_stop,_time,_value,_field,_measurement,entity_id",
            ]
        unit = "°C" if k < 3 else "%" if k < 5 else "W"
        for at, value in HOUSE[name].items():
            lines.append(
                f",,{k},2026-01-12T00:00:00Z,2026-01-17T00:00:00Z,{at:%Y-%m-%dT%H:%M:%SZ},{value},value,{unit},{entity[7:]}"
            )
        lines.append("")
    (folder / "influx.csv").write_bytes("\r\n".join(lines).encode())
    return [folder / "influx.csv"]


def metasys(folder: Path) -> list[Path]:
    """One row per reading, 12-hour clock, the United States' dates, °F in the names."""
    names = {
        "living": "RM101 ZN-T",
        "bath": "RM102 ZN-T",
        "out": "OA-T",
        "v_living": "RM101 VLV-O",
        "v_bath": "RM102 VLV-O",
        "power": "HP-1 KW",
    }
    parts = []
    for name, point in names.items():
        x = (
            HOUSE[name] * 1.8 + 32
            if name in ("living", "bath", "out")
            else HOUSE[name] / (1000 if name == "power" else 1)
        )
        stamps = local("%m/%d/%Y %I:%M:%S %p")
        parts.append(
            pd.DataFrame(
                {
                    "Date / Time": stamps,
                    "Object Name": point,
                    "Object Value": x.round(4).to_numpy(),
                    "Reliability": "Reliable",
                }
            )
        )
    pd.concat(parts).to_csv(folder / "metasys.csv", index=False)
    return [folder / "metasys.csv"]


def niagara(folder: Path) -> list[Path]:
    files = []
    names = {
        "living": "Living_SpaceTemp",
        "bath": "Bath_SpaceTemp",
        "out": "OutdoorTemp",
        "v_living": "Living_ValvePos",
        "v_bath": "Bath_ValvePos",
        "power": "HeatPump_Power",
    }
    for name, point in names.items():
        unit = {"v": "%", "p": "W"}.get(name[0], "°C")
        rows = [f"history:/House/{point}", f"Timestamp,Trend Flags,Status,Value ({unit})"]
        stamps = local("%d-%b-%y %I:%M:%S %p")
        rows += [f"{at} CET,{{ }},{{ok}},{value}" for at, value in zip(stamps, HOUSE[name], strict=True)]
        rows.insert(9, f"{stamps[7]} CET,{{ }},{{stale}},{HOUSE[name].iloc[7]}") if name == "power" else None
        files.append(folder / f"export ({len(files)}).csv")
        files[-1].write_text("\n".join(rows) + "\n", encoding="utf-8")
    return files


def rooms(folder: Path) -> list[Path]:
    """A file per room with the same columns, and the weather and the machine in one of their own."""
    stamps = local("%Y-%m-%d %H:%M:%S")
    for room in ("living", "bath"):
        columns = {
            "timestamp": stamps,
            "temperature": HOUSE[room].to_numpy(),
            "setpoint": 21.0,
            "valve": HOUSE[f"v_{room}"].to_numpy(),
            "humidity": 45,
        }
        pd.DataFrame(columns).to_csv(folder / f"{room}.csv", index=False)
    columns = {
        "timestamp": stamps,
        "temperature outdoor": HOUSE["out"].to_numpy(),
        "heat pump power (W)": HOUSE["power"].to_numpy(),
    }
    pd.DataFrame(columns).to_csv(folder / "house.csv", index=False)
    return [folder / "living.csv", folder / "bath.csv", folder / "house.csv"]


def german(folder: Path) -> list[Path]:
    months = ["Januar", "Februar", "März"]
    stamps = [f"{t.day:02d}. {months[t.month - 1]} {t.year} {t:%H:%M}" for t in HOUSE.index.tz_convert(ZONE)]
    names = {
        "living": "Wohnzimmer [°C]",
        "bath": "Bad [°C]",
        "out": "Außen [°C]",
        "v_living": "Ventil Wohnzimmer [%]",
        "v_bath": "Ventil Bad [%]",
        "power": "Wärmepumpe [W]",
    }
    df = HOUSE.rename(columns=names).set_axis(pd.Index(stamps, name="Datum"))
    text = df.to_csv(sep=";", decimal=",")
    (folder / "tabelle.csv").write_bytes(("Bericht vom 20.01.2026\nHaus;Musterstraße\n" + text).encode("cp1252"))
    return [folder / "tabelle.csv"]


def two_columns(folder: Path) -> list[Path]:
    df = HOUSE.rename(columns={k: v[7:] for k, v in ENTITIES.items()}).reset_index(drop=True)
    df.insert(0, "Date", local("%Y-%m-%d"))
    df.insert(1, "Time", local("%H:%M:%S"))
    text = "# exported by a thermostat\n" + df.to_csv(index=False)
    (folder / "ecobee.csv").write_text("\ufeff" + text, encoding="utf-8")
    return [folder / "ecobee.csv"]


def intervals(folder: Path) -> list[Path]:
    ends = (HOUSE.index + pd.Timedelta("15min")).tz_convert(ZONE)
    begins = HOUSE.index.tz_convert(ZONE)
    stamps = [f"{a:%d.%m.%Y %H:%M} - {b:%d.%m.%Y %H:%M}" for a, b in zip(begins, ends, strict=True)]
    df = HOUSE.rename(columns={k: v[7:] for k, v in ENTITIES.items()}).set_axis(pd.Index(stamps, name="MTU"))
    df.to_csv(folder / "mtu.csv")
    return [folder / "mtu.csv"]


def french(folder: Path) -> list[Path]:
    months = ["janv.", "févr.", "mars"]
    stamps = [f"{t.day} {months[t.month - 1]} {t.year} {t:%H:%M}" for t in HOUSE.index.tz_convert(ZONE)]
    names = {
        "living": "Température salon (°C)",
        "bath": "Température salle de bain (°C)",
        "out": "Température extérieure (°C)",
        "v_living": "Vanne salon (%)",
        "v_bath": "Vanne salle de bain (%)",
        "power": "Puissance PAC (W)",
    }
    df = HOUSE.rename(columns=names).set_axis(pd.Index(stamps, name="Horodatage"))
    df.to_csv(folder / "maison.csv", sep=";", decimal=",")
    return [folder / "maison.csv"]


def units_below(folder: Path) -> list[Path]:
    """A line of units below the names, tabs, an offset in whole hours."""
    df = HOUSE.rename(columns={k: v[7:] for k, v in ENTITIES.items()})
    stamps = [f"{t:%Y-%m-%d %H:%M:%S}+01" for t in HOUSE.index.tz_convert(ZONE)]
    text = df.set_axis(pd.Index(stamps, name="time")).to_csv(sep="\t").split("\n")
    text.insert(1, "\t".join(["", "°C", "°C", "°C", "%", "%", "W"]))
    (folder / "db.csv").write_text("\n".join(text), encoding="utf-8")
    return [folder / "db.csv"]


LAYOUTS = (
    ha_history,
    ha_statistics,
    influx,
    metasys,
    niagara,
    rooms,
    german,
    two_columns,
    intervals,
    french,
    units_below,
)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda one: one.__name__)
def test_an_export_is_read_by_the_map_that_is_written_for_it(layout, tmp_path):
    files = layout(tmp_path)
    text = starting_map(files)
    text = text.replace("zone: America/New_York", f"zone: {ZONE}").replace("zone: Europe/Paris", f"zone: {ZONE}")
    text = text.replace("zone: Europe/Brussels", f"zone: {ZONE}")
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    found = tf.read_measurements(files, tmp_path / "map.yaml")
    record = found.record
    by_zone = {("living" if z == 0 else "bath"): T for z, T in enumerate(record.T_zone_C)}
    if any("bath" in name or "bad" in name or "bain" in name or "102" in name for name in record.names.zones[:1]):
        by_zone = dict(zip(("bath", "living"), record.T_zone_C, strict=True))
    at = record.stamps().tz_convert("UTC")
    truth = HOUSE.reindex(at)
    assert len(at) >= N - 2, text
    kept = slice(2, -16)  # where changes are stored nothing is known before the first, nor between the last two
    for room in ("living", "bath"):
        error = np.abs(by_zone[room][kept] - truth[room].to_numpy()[kept])
        assert np.nanmax(error) < 0.35, text  # between two changes a straight line
        assert np.isfinite(error).mean() > 0.98
    assert np.nanmax(np.abs(record.T_out_C[kept] - truth["out"].to_numpy()[kept])) < 0.35
    assert np.nanmax(np.abs(record.power_W[0][kept] - truth["power"].to_numpy()[:-1][kept])) < 6.0
    assert len(record.names.actuators) == 2, text
    for a, home in enumerate(found.layout.home):
        room = next(
            name
            for name, T in by_zone.items()
            if T is record.T_zone_C[home] or np.array_equal(T, record.T_zone_C[home], equal_nan=True)
        )
        np.testing.assert_allclose(record.u[a][kept], truth[f"v_{room}"].to_numpy()[:-1][kept] / 100, atol=1e-6)


def test_files_of_different_rooms_are_not_one_room(tmp_path):
    files = rooms(tmp_path)
    rules = {"time": {"zone": ZONE}, "outdoor": "humidity", "zones": {"living": {"temperature": "temperature"}}}
    for time in ({}, {"order": "sort", "duplicates": "first"}):
        with pytest.raises(DataError, match=r"of different rooms or points\. Set table: \{by_file: prefix\}"):
            tf.read_measurements(files[:2], rules | {"time": {"zone": ZONE, **time}})


def test_an_outage_of_the_logger_is_a_gap_of_every_signal(tmp_path):
    (history,) = ha_history(tmp_path)
    df = pd.read_csv(history)
    many = [df.assign(entity_id=df["entity_id"] + f"_{k}") for k in range(4)]
    df = pd.concat([df, *many])
    gone = (df["last_changed"] > "2026-01-13T06") & (df["last_changed"] < "2026-01-13T18")
    df[~gone].to_csv(history, index=False)
    (tmp_path / "map.yaml").write_text(starting_map(history), encoding="utf-8")
    found = tf.read_measurements(history, tmp_path / "map.yaml")
    assert any("nothing at all was stored from 2026-01-13 05:45" in told for told in found.understood.assumed)
    at = found.record.stamps()
    inside = (at > pd.Timestamp("2026-01-13T07Z")) & (at < pd.Timestamp("2026-01-13T17Z"))
    assert np.isnan(found.record.T_zone_C[:, inside]).all()
    assert np.isnan(found.record.u[:, inside[:-1]]).all()


def test_a_picture_is_no_code_page(tmp_path):
    (tmp_path / "plot.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 9)
    for read in (
        starting_map,
        lambda path: tf.read_measurements(path, {"outdoor": "o", "zones": {"z": {"temperature": "t"}}}),
    ):
        with pytest.raises(DataError, match="is no table but a picture"):
            read(tmp_path / "plot.png")


def test_a_workbook_is_read_or_said_to_need_a_package(tmp_path):
    (tmp_path / "house.xlsx").write_bytes(b"PK\x03\x04")
    try:
        import python_calamine  # noqa: F401
    except ModuleNotFoundError:
        with pytest.raises(DataError, match=r"workbooks are read with python-calamine: pip install"):
            starting_map(tmp_path / "house.xlsx")
        return
    with pytest.raises(DataError, match="no workbook that can be read"):
        starting_map(tmp_path / "house.xlsx")
