"""Tables as programs export them: `tf-mpc data map` takes each for what it is, and its map reads the right values."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import thermoforce_mpc as tf
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.map.starting_map import doubt_of_zone, starting_map
from thermoforce_mpc.scenario.comfort import Comfort

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


def line_protocol(folder: Path) -> list[Path]:
    """As `influxd inspect export-lp` writes it, of Home Assistant's readings: text beside numbers, escaped spaces."""
    lines = ["# INFLUXDB EXPORT: 2026-01-12T00:00:00Z - 2026-01-17T00:00:00Z", "# DDL", "CREATE DATABASE ha", "# DML"]
    for k, (name, entity) in enumerate(ENTITIES.items()):
        unit = "°C" if k < 3 else "%" if k < 5 else "W"
        beside = f'friendly_name_str="The {name}, of the \\"house\\""'
        tags = f"domain=sensor,entity_id={entity[7:]},source=Home\\ Assistant"
        lines += [f"{unit},{tags} {beside},value={v} {at.as_unit('ns').value}" for at, v in HOUSE[name].items()]
    lines += [f'state,entity_id=mode state="heat",value=1i {HOUSE.index[3].as_unit("ns").value}']
    (folder / "dump.lp").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [folder / "dump.lp"]


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


def grafana(folder: Path) -> list[Path]:
    """Cells as a panel shows them: a unit behind each number, W below a kilowatt and kW above."""
    names = {k: v[7:].replace("_", " ") for k, v in ENTITIES.items()}
    df = pd.DataFrame({"Time": local("%Y-%m-%d %H:%M:%S")})
    for name, told in names.items():
        unit = "W" if name == "power" else "%" if name[0] == "v" else "°C"
        x = HOUSE[name]
        df[told] = [f"{v / 1000:.3f} kW" if unit == "W" and v > 1000 else f"{v} {unit}" for v in x]
    df.to_csv(folder / "panel.csv", index=False, quoting=1)
    return [folder / "panel.csv"]


def siemens(folder: Path) -> list[Path]:
    """A trend report: points are named above the table, and it says where it ends."""
    points = ("B1.R101.ROOM TEMP", "B1.R102.ROOM TEMP", "B1.OAT", "B1.R101.HTG VLV", "B1.R102.HTG VLV", "B1.HP1.KW")
    head = ['"Key            Name:Suffix                     Trend Definitions Used"']
    head += [f'"Point_{k}:","{point}","","15 minutes"' for k, point in enumerate(points, start=1)]
    head += ['"Time Interval:","15 Minutes"', '"Report Timings:","All Hours"', '""']
    df = HOUSE.assign(power=HOUSE["power"] / 1000).set_axis([f"Point_{k}" for k in range(1, 7)], axis=1)
    df[["Point_1", "Point_2", "Point_3"]] = df[["Point_1", "Point_2", "Point_3"]] * 1.8 + 32
    df = df.reset_index(drop=True)
    df.insert(0, "<>Date", local("%m/%d/%Y"))
    df.insert(1, "Time", local("%H:%M:%S"))
    text = df.to_csv(index=False, quoting=1, lineterminator="\r\n")
    end = '" ******************* End of Report *******************"\r\n'
    (folder / "trend.csv").write_text("\r\n".join(head) + "\r\n" + text + end, encoding="utf-8", newline="")
    return [folder / "trend.csv"]


def danish(folder: Path) -> list[Path]:
    names = ("Stuetemperatur", "Badeværelse temperatur", "Udetemperatur", "Ventil stue (%)", "Ventil badeværelse (%)")
    df = HOUSE.set_axis([*names, "Varmepumpe effekt (W)"], axis=1).reset_index(drop=True)
    df.insert(0, "Tidspunkt", local("%d-%m-%Y %H:%M"))
    df.to_csv(folder / "hus.csv", sep=";", decimal=",", index=False)
    return [folder / "hus.csv"]


def finnish(folder: Path) -> list[Path]:
    names = (
        "Olohuone lämpötila",
        "Kylpyhuone lämpötila",
        "Ulkolämpötila",
        "Venttiili olohuone",
        "Venttiili kylpyhuone",
    )
    df = HOUSE.set_axis([*names, "Lämpöpumppu teho (W)"], axis=1).reset_index(drop=True)
    df.insert(0, "Aika", local("%d.%m.%Y %H:%M"))
    df.to_csv(folder / "talo.csv", sep=";", decimal=",", index=False)
    return [folder / "talo.csv"]


def newest_first(folder: Path) -> list[Path]:
    df = HOUSE.rename(columns={k: v[7:] for k, v in ENTITIES.items()}).reset_index(drop=True)
    df.insert(0, "time", local("%d/%m/%Y %H:%M"))
    df.iloc[::-1].to_csv(folder / "latest.csv", index=False)
    return [folder / "latest.csv"]


def hobo(folder: Path) -> list[Path]:
    """Names with commas in quotes, an offset in the name of the stamps, numbered rows."""
    names = {
        "living": "Temp, °C (LGR S/N: 1023, SEN S/N: 21, LBL: Living room)",
        "bath": "Temp, °C (LGR S/N: 1023, SEN S/N: 22, LBL: Bath)",
        "out": "Temp, °C (LGR S/N: 1023, SEN S/N: 23, LBL: Outdoor)",
        "v_living": "Valve, % (LGR S/N: 1023, LBL: Living room)",
        "v_bath": "Valve, % (LGR S/N: 1023, LBL: Bath)",
        "power": "Heat pump power, W (LGR S/N: 1023)",
    }
    df = HOUSE.rename(columns=names).reset_index(drop=True)
    df.insert(0, "Date Time, GMT+01:00", local("%m/%d/%y %I:%M:%S %p"))
    text = df.rename_axis("#").to_csv(quoting=2)
    (folder / "hobo.csv").write_text('"Plot Title: 1023"\n' + text, encoding="utf-8")
    return [folder / "hobo.csv"]


def iobroker(folder: Path) -> list[Path]:
    """One file a signal, stamps in ms, with what the program knows of each reading beside."""
    files = []
    for name, entity in ENTITIES.items():
        ms = HOUSE.index.as_unit("ms").asi8
        df = pd.DataFrame({"timestamp": ms, "value": HOUSE[name].to_numpy(), "acknowledged": "true"})
        df["from"], df["quality"] = "system.adapter.hm-rpc.0", 0
        files.append(folder / f"{entity[7:].replace('_', '.')}.csv")
        df.to_csv(files[-1], sep=";", index=False)
    return files


def knx(folder: Path) -> list[Path]:
    """A bus monitor: readings of several units in one column, behind their telegrams, on change."""
    names = {
        "living": ("EG Wohnzimmer Isttemperatur", "°C"), "bath": ("EG Bad Isttemperatur", "°C"),
        "out": ("Wetterstation Aussentemperatur", "°C"), "v_living": ("EG Wohnzimmer Stellgröße", "%"),
        "v_bath": ("EG Bad Stellgröße", "%"), "power": ("Wärmepumpe Wirkleistung", "W"),
    }  # fmt: skip
    rows, stamps = [], local("%d.%m.%Y %H:%M:%S")
    for name, (told, unit) in names.items():
        x = HOUSE[name].to_numpy()
        rows += [
            (stamps[k], "1.1.12", f"3/1/{len(told)}", told, "DPT 9", f"$0C3F | {x[k]:.2f} {unit}".replace(".", ","))
            for k in np.flatnonzero(np.append(True, np.diff(x) != 0))
        ]  # fmt: skip
    header = ["Time", "Source Address", "Destination Address", "Destination Name", "DPT", "Info"]
    lines = [";".join(header), *(";".join(map(str, row)) for row in rows)]
    (folder / "ets.csv").write_text("\n".join(lines), encoding="utf-8")
    return [folder / "ets.csv"]


def fhem(folder: Path) -> list[Path]:
    """A device has several readings, and their kind stands in a column of its own."""
    names = {
        "living": ("Wohnzimmer.Heizung", "measured-temp"), "v_living": ("Wohnzimmer.Heizung", "pct"),
        "bath": ("Bad.Heizung", "measured-temp"), "v_bath": ("Bad.Heizung", "pct"),
        "out": ("Aussen", "temperature"), "power": ("WP.Zaehler", "power"),
    }  # fmt: skip
    parts = [
        pd.DataFrame(
            {"TIMESTAMP": local("%Y-%m-%d %H:%M:%S"), "DEVICE": device, "TYPE": "CUL_HM", "READING": reading,
             "VALUE": HOUSE[name].to_numpy()}
        )
        for name, (device, reading) in names.items()
    ]  # fmt: skip
    pd.concat(parts).to_csv(folder / "fhem.csv", index=False, sep=";")
    return [folder / "fhem.csv"]


def campbell(folder: Path) -> list[Path]:
    """Two lines below the names, of units and of how readings were sampled, and one above."""
    names = ["TIMESTAMP", "RECORD", "T_living_Avg", "T_bath_Avg", "T_out_Avg", "Vlv_living", "Vlv_bath", "P_hp_Avg"]
    units = ["TS", "RN", "Deg C", "Deg C", "Deg C", "%", "%", "W"]
    sampled = ["", "", "Avg", "Avg", "Avg", "Smp", "Smp", "Avg"]
    table = HOUSE[["living", "bath", "out", "v_living", "v_bath", "power"]].to_numpy()
    rows = [[f"{at}", k, *row] for k, (at, row) in enumerate(zip(local("%Y-%m-%d %H:%M:%S"), table, strict=True))]
    above = '"TOA5","Station","CR1000","12345","CR1000.Std.32","CPU:prog.CR1","1234","T15","x"'
    quoted = [",".join(f'"{cell}"' for cell in line) for line in (names, units, sampled)]
    (folder / "TOA5.dat").write_text("\n".join([above, *quoted, *(",".join(map(str, row)) for row in rows)]))
    return [folder / "TOA5.dat"]


def groups(folder: Path) -> list[Path]:
    """Names that come twice under a line of groups, weekdays, a.m. and p.m., words for no reading, sums at the end."""
    group = ",Living room,,Bath,,Outside,Heat pump"
    names = "Date,Temperature (°C),Valve (%),Temperature (°C),Valve (%),Temperature (°C),Power (W)"
    rows = []
    for k, at in enumerate(HOUSE.index.tz_convert(ZONE)):
        row = HOUSE.iloc[k]
        half = "a.m." if at.hour < 12 else "p.m."
        living = "Fault" if k % 77 == 5 else row.living
        stamp = f"{at:%A} {at:%d %B %Y %I:%M} {half}"
        rows.append(f"{stamp},{living},{row.v_living},{row.bath},{row.v_bath},{row.out},{row.power}")
    rows += [f"Average,,,,,{HOUSE.out.mean():.1f},{HOUSE.power.mean():.0f}", "Total,,,,,,1234567"]
    (folder / "groups.csv").write_text("\n".join([group, names, *rows]), encoding="utf-8")
    return [folder / "groups.csv"]


def spreadsheet(folder: Path) -> list[Path]:
    """Days since 1899 and spaces between thousands."""
    days = (HOUSE.index.tz_convert(ZONE).tz_localize(None) - pd.Timestamp("1899-12-30")) / pd.Timedelta("1D")
    names = [
        "Date",
        "Séjour °C",
        "Salle de bain °C",
        "Extérieur °C",
        "Vanne séjour %",
        "Vanne salle de bain %",
        "PAC W",
    ]
    lines = [";".join(names)]
    for day, row in zip(days, HOUSE.itertuples(), strict=True):
        power = f"{row.power:,.0f}".replace(",", "\u202f")
        cells = (f"{day:.5f}", row.living, row.bath, row.out, row.v_living, row.v_bath, power)
        lines.append(";".join(str(cell).replace(".", ",") for cell in cells))
    (folder / "classeur.csv").write_text("\n".join(lines), encoding="utf-8")
    return [folder / "classeur.csv"]


def netatmo(folder: Path) -> list[Path]:
    """A file a module, of two clocks and with three lines above; the heating in a table of another program."""
    files, seconds = [], HOUSE.index.as_unit("s").asi8
    for name, module, kind in (
        ("living", "Wohnzimmer", "Indoor"),
        ("bath", "Bad", "Indoor"),
        ("out", "Aussen", "Outdoor"),
    ):
        lines = ["Name;Long;Lat;ModuleName;ModuleType", f'"Haus";11.58;48.13;"{module}";"{kind}"']
        lines += ['Timestamp;"Timezone : Europe/Berlin";Temperature;Humidity' + ";CO2" * (kind == "Indoor")]
        for at, told, value in zip(seconds, local("%Y/%m/%d %H:%M:%S"), HOUSE[name], strict=True):
            lines.append(f'{at};"{told}";{value};45' + ";650" * (kind == "Indoor"))
        files.append(folder / f"{module}_{kind}_12_1_2026.csv")
        files[-1].write_text("\n".join(lines) + "\n", encoding="utf-8")
    names = {"v_living": "Ventil Wohnzimmer %", "v_bath": "Ventil Bad %", "power": "Wärmepumpe W"}
    df = HOUSE[list(names)].rename(columns=names).reset_index(drop=True)
    df.insert(0, "Zeit", local("%d.%m.%Y %H:%M"))
    df.to_csv(folder / "heizung.csv", index=False, decimal=",", sep=";")
    return [*files, folder / "heizung.csv"]


def switchbot(folder: Path) -> list[Path]:
    """A file a meter with its dew point, degrees as one character."""
    files = []
    for name, told in (("living", "Living Room_data"), ("bath", "Bath_data"), ("out", "Outdoor Meter_data")):
        columns = {"Timestamp": local("%Y-%m-%d %H:%M"), "Temperature_Celsius(℃)": HOUSE[name].to_numpy()}
        columns |= {"Relative_Humidity(%)": 45, "DPT(℃)": 9.5, "VPD(kPa)": 1.2}
        files.append(folder / f"{told}.csv")
        pd.DataFrame(columns).to_csv(files[-1], index=False, encoding="utf-8-sig")
    return [*files, _heating(folder)]


def govee(folder: Path) -> list[Path]:
    """The United States' degrees, and files called exports of a day."""
    files = []
    for name, told in (("living", "Living"), ("bath", "Bath"), ("out", "Outside")):
        columns = {"Timestamp for sample frequency every 15 min min": local("%Y-%m-%d %H:%M:%S")}
        columns |= {"Temperature_Fahrenheit": (HOUSE[name] * 1.8 + 32).round(2).to_numpy(), "Relative_Humidity": 45.2}
        files.append(folder / f"{told}_export202601121200.csv")
        pd.DataFrame(columns).to_csv(files[-1], index=False)
    return [*files, _heating(folder)]


def _heating(folder: Path) -> Path:
    names = {"v_living": "valve living (%)", "v_bath": "valve bath (%)", "power": "heat pump (W)"}
    df = HOUSE[list(names)].rename(columns=names).reset_index(drop=True)
    df.insert(0, "Timestamp", local("%Y-%m-%d %H:%M"))
    df.to_csv(folder / "heat.csv", index=False)
    return folder / "heat.csv"


def shelly(folder: Path) -> list[Path]:
    """A meter that counts from 1970 and tells more than means, beside stamps of ISO 8601."""
    rooms = HOUSE.rename(columns={k: v[7:] for k, v in ENTITIES.items()}).drop(columns="heat_pump_power")
    rooms.set_axis(HOUSE.index.strftime("%Y-%m-%dT%H:%M:%SZ")).to_csv(folder / "rooms.csv", index_label="time")
    power = HOUSE["power"].to_numpy()
    columns = {"timestamp": HOUSE.index.as_unit("s").asi8, "total_act_energy": power / 4, "max_act_power": power + 90}
    columns |= {
        "total_act_ret_energy": 0.0,
        "min_act_power": power - 90,
        "max_aprt_power": power + 99,
        "avg_voltage": 232,
    }
    pd.DataFrame(columns).to_csv(folder / "shelly.csv", index=False)
    return [folder / "rooms.csv", folder / "shelly.csv"]


def emporia(folder: Path) -> list[Path]:
    """Plurals of units, circuits without a sensor, the zone in the header; rooms as Home Assistant stores them."""
    rooms = ha_history(folder)
    table = pd.read_csv(rooms[0])
    table[table["entity_id"] != ENTITIES["power"]].to_csv(rooms[0], index=False)
    new_york = pd.Series(HOUSE.index.tz_convert("America/New_York").strftime("%m/%d/%Y %H:%M:%S"))
    columns = {"Time Bucket (America/New_York)": new_york, "Mains_A (kWhs)": HOUSE["power"] / 4000 + 1}
    columns |= {"Heat Pump (kWhs)": HOUSE["power"] / 4000, "Dryer (kWhs)": "No CT"}
    pd.DataFrame({k: getattr(v, "array", v) for k, v in columns.items()}).to_csv(folder / "1MIN.csv", index=False)
    return [*rooms, folder / "1MIN.csv"]


def desigo(folder: Path) -> list[Path]:
    """Thousandths of a second behind a comma, a unit in a column of its own."""
    names = {
        "living": "GA.R101.Raumtemp.Istwert", "bath": "GA.R102.Raumtemp.Istwert", "out": "GA.Witterung.Aussentemp",
        "v_living": "GA.R101.Heizventil.Stellwert", "v_bath": "GA.R102.Heizventil.Stellwert",
        "power": "GA.WP01.Leistung",
    }  # fmt: skip
    lines = ["Zeitstempel;Datenpunkt;Wert;Einheit;Qualität"]
    for name, point in names.items():
        unit = {"v": "%", "p": "kW"}.get(name[0], "°C")
        values = [f"{v:.3f}".replace(".", ",") for v in HOUSE[name] / (1000 if name == "power" else 1)]
        stamps = local("%d.%m.%Y %H:%M:%S,000")
        lines += [f"{at};{point};{value};{unit};gut" for at, value in zip(stamps, values, strict=True)]
    (folder / "trend.csv").write_text("\n".join(lines), encoding="cp1252")
    return [folder / "trend.csv"]


def nibe(folder: Path) -> list[Path]:
    """A Swedish cloud's table; one room has a valve that its name does not tell."""
    names = {
        "living": "Rumstemperatur (BT50) [°C]", "bath": "Badrum temperatur [°C]",
        "out": "Aktuell utetemperatur (BT1) [°C]", "v_living": "Ventil vardagsrum [%]", "v_bath": "Ventil badrum [%]",
        "power": "Momentan använd effekt [W]",
    }  # fmt: skip
    df = HOUSE.rename(columns=names).reset_index(drop=True)
    df.insert(4, "Framledning (BT2) [°C]", 30 + HOUSE["v_living"].to_numpy() / 10)
    df.insert(5, "Gradminuter [GM]", -120)
    df.insert(0, "Tidpunkt", local("%Y-%m-%d %H:%M:%S"))
    df.to_csv(folder / "nibe.csv", sep=";", decimal=",", index=False, encoding="utf-8-sig")
    return [folder / "nibe.csv"]


def nest(folder: Path) -> list[Path]:
    """Google's takeout: a folder a thermostat, with a file a month that is called alike; extremes beside means."""
    files = []
    for room in ("living", "bath"):
        T = HOUSE[room].to_numpy()
        df = pd.DataFrame({"Date": local("%Y-%m-%d"), "Time": local("%H:%M"), "avg(temp)": T, "min(temp)": T - 0.4})
        df = df.assign(
            **{"max(temp)": T + 0.4, "avg(humidity)": 41.0, "heat1(level)": HOUSE[f"v_{room}"].to_numpy() / 100}
        )
        (folder / room).mkdir()
        for part, rows in enumerate((slice(0, N // 2), slice(N // 2, None)), start=1):
            files.append(folder / room / f"2026-{part:02d}-sensors.csv")
            df.iloc[rows].to_csv(files[-1], index=False)
    other = {"outdoor temperature": HOUSE["out"].to_numpy(), "heat pump power (W)": HOUSE["power"].to_numpy()}
    (folder / "house").mkdir()
    files.append(folder / "house" / "other.csv")
    df[["Date", "Time"]].assign(**other).to_csv(files[-1], index=False)
    return files


def telegraf(folder: Path) -> list[Path]:
    """What a broker said: a topic has several fields."""
    of = {
        "living": ("zigbee2mqtt/living", "temperature"), "v_living": ("zigbee2mqtt/living", "pi_heating_demand"),
        "bath": ("zigbee2mqtt/bath", "temperature"), "v_bath": ("zigbee2mqtt/bath", "pi_heating_demand"),
        "out": ("zigbee2mqtt/outdoor", "temperature"), "power": ("shelly/heatpump", "apower"),
    }  # fmt: skip
    stamps = HOUSE.index.strftime("%Y-%m-%dT%H:%M:%SZ")
    parts = [
        pd.DataFrame({"time": stamps, "topic": topic, "field": field, "value": HOUSE[name].to_numpy()})
        for name, (topic, field) in of.items()
    ]
    pd.concat(parts).sort_values("time", kind="stable").to_csv(folder / "mqtt.csv", index=False)
    return [folder / "mqtt.csv"]


def knx_in_german(folder: Path) -> list[Path]:
    """ETS 6: tabs and quotes, senders named before what they send to, telegrams that ask beside those that tell."""
    (file,) = knx(folder)
    df = pd.read_csv(file, sep=";", dtype=str).rename(columns={"Time": "Zeit", "Destination Name": "Zielname"})
    df["Typ"] = "GroupValueWrite"
    asks = df[df["Zeit"] == df["Zeit"].iloc[0]].assign(Zeit="13.01.2026 10:01:00", Typ="GroupValueRead", Info="")
    df = pd.concat([df, asks], ignore_index=True)
    df.insert(1, "Service", "vom Bus")
    df.insert(3, "Quellname", np.where(np.arange(len(df)) % 2, "Aktor", "Sensor"))
    df.insert(0, "#", np.arange(len(df)))
    df.to_csv(folder / "ets6.csv", sep="\t", index=False, quoting=1, encoding="utf-8-sig")
    return [folder / "ets6.csv"]


def victron(folder: Path) -> list[Path]:
    """Three lines above: devices, names with the zone of the stamps, units."""
    names = ("Living temperature", "Bath temperature", "Outdoor temperature", "Living valve", "Bath valve", "Power")
    lines = [
        ["timestamp", *(f"Sensor [{k}]" for k in range(24, 30))], [f"{ZONE} (+01:00)", *names],
        ["", "°C", "°C", "°C", "%", "%", "W"],
    ]  # fmt: skip
    stamps = local("%Y-%m-%d %H:%M:%S")
    lines += [[stamps[k], *map(str, row)] for k, row in enumerate(HOUSE.to_numpy())]
    text = "\n".join(",".join(f'"{cell}"' for cell in line) for line in lines)
    (folder / "vrm.csv").write_text(text + "\n", encoding="utf-8")
    return [folder / "vrm.csv"]


def smartthings(folder: Path) -> list[Path]:
    """A device has several attributes, in °F by a column of units, with a clock of 12 hours."""
    of = {
        "living": ("Living Thermostat", "temperature"), "v_living": ("Living Thermostat", "valve"),
        "bath": ("Bath Thermostat", "temperature"), "v_bath": ("Bath Thermostat", "valve"),
        "out": ("Outdoor Sensor", "temperature"), "power": ("Heat Pump", "power"),
    }  # fmt: skip
    parts = []
    for name, (device, attribute) in of.items():
        unit = {"temperature": "F", "valve": "%", "power": "W"}[attribute]
        value = np.round(1.8 * HOUSE[name].to_numpy() + 32, 2) if unit == "F" else HOUSE[name].to_numpy()
        told = {"Date": local("%m/%d/%Y %I:%M:%S %p"), "Device": device, "Attribute": attribute, "Value": value}
        parts.append(pd.DataFrame(told | {"Unit": unit}))
    pd.concat(parts).sort_index(kind="stable").to_csv(folder / "events.csv", index=False)
    return [folder / "events.csv"]


LAYOUTS = (
    victron,
    smartthings,
    nest,
    telegraf,
    knx_in_german,
    netatmo,
    switchbot,
    govee,
    shelly,
    emporia,
    desigo,
    nibe,
    knx,
    fhem,
    campbell,
    groups,
    spreadsheet,
    ha_history,
    ha_statistics,
    influx,
    line_protocol,
    metasys,
    niagara,
    rooms,
    german,
    two_columns,
    intervals,
    french,
    units_below,
    grafana,
    siemens,
    danish,
    finnish,
    newest_first,
    hobo,
    iobroker,
)


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda one: one.__name__)
def test_an_export_is_read_by_the_map_that_is_written_for_it(layout, tmp_path):
    files = layout(tmp_path)
    text = starting_map(files)
    text = text.replace("zone: America/New_York", f"zone: {ZONE}").replace("zone: Europe/Paris", f"zone: {ZONE}")
    for guessed in ("Europe/Brussels", "Europe/Helsinki"):
        text = text.replace(f"zone: {guessed}", f"zone: {ZONE}")
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


def test_a_heat_pump_s_log_is_divided_by_what_stands_above_it(tmp_path):
    """NIBE's log: ten times the reading, sensors by their numbers, a frequency."""
    names = ["Date", "Time", "BT1(40004)", "BT2(40008)", "BT6(40014)", "BT50(40033)", "Compr. freq. act.(43136)"]
    lines = ["\t".join(["Divisors", "", "10", "10", "10", "10", "10"]), "\t".join(names)]
    for k, (at, row) in enumerate(HOUSE.iterrows()):
        stamp = at.tz_convert(ZONE).strftime("%Y-%m-%d\t%H:%M:%S")
        values = (row["out"], 30 + row["v_living"] / 10, 48 + k % 7, row["living"], 0.6 * row["v_living"])
        lines.append("\t".join([stamp, *(f"{10 * value:.0f}" for value in values)]))
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = starting_map(tmp_path / "log.csv")
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    record = tf.read_measurements(tmp_path / "log.csv", tmp_path / "map.yaml").record
    assert "FILL IN" not in text
    np.testing.assert_allclose(record.T_zone_C[0], HOUSE["living"].iloc[: record.T_zone_C.shape[1]], atol=0.06)
    np.testing.assert_allclose(record.T_out_C, HOUSE["out"].iloc[: record.T_out_C.size], atol=0.06)
    np.testing.assert_allclose(record.u[0], 0.6 * HOUSE["v_living"].iloc[: record.u.shape[1]] / 100, atol=1e-3)


def test_seconds_of_an_interval_are_a_level(tmp_path):
    """A thermostat's report in °F: how many of each 900 s a stage ran."""
    df = HOUSE.reset_index(drop=True)
    table = pd.DataFrame({"Date": local("%Y-%m-%d"), "Time": local("%H:%M:%S")})
    table["Heat Set Temp (F)"] = 68
    table["Current Temp (F)"], table["Outdoor Temp (F)"] = df["living"] * 1.8 + 32, df["out"] * 1.8 + 32
    table["Heat Stage 1 (sec)"], table["Fan (sec)"] = (9 * df["v_living"]).astype(int), 0
    (tmp_path / "report.csv").write_text(f"#Thermostat:,1\n#\n{table.to_csv(index=False)}", encoding="utf-8")
    text = starting_map(tmp_path / "report.csv").replace("America/New_York", ZONE)
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    record = tf.read_measurements(tmp_path / "report.csv", tmp_path / "map.yaml").record
    np.testing.assert_allclose(record.u[0], HOUSE["v_living"].iloc[: record.u.shape[1]] / 100, atol=2e-3)
    np.testing.assert_allclose(record.T_zone_C[0], HOUSE["living"].iloc[: record.T_zone_C.shape[1]], atol=1e-6)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_stamps_that_count_from_1970_are_told_by_their_size(unit, tmp_path):
    df = HOUSE[["living", "out"]].rename(columns={"living": "indoor", "out": "outdoor"})
    df.set_axis(pd.Index(HOUSE.index.as_unit(unit).asi8, name="time")).to_csv(tmp_path / "q.csv")
    text = starting_map(tmp_path / "q.csv")
    assert f"unit: {unit}" in text
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    assert tf.read_measurements(tmp_path / "q.csv", tmp_path / "map.yaml").record.stamps()[0] == HOUSE.index[0]


@pytest.mark.parametrize("told", ["GMT", "America/New_York", "Etc/GMT-3"])
def test_weather_is_of_the_zone_that_stands_above_it(told, tmp_path):
    """Open-Meteo's table: what it knows of the place, a line of values, an empty one."""
    stamps = HOUSE.index.tz_convert(told).strftime("%Y-%m-%dT%H:%M")
    table = pd.DataFrame(
        {"time": stamps, "temperature_2m (°C)": HOUSE["out"].array, "room (°C)": HOUSE["living"].array}
    )
    above = "latitude,longitude,elevation,utc_offset_seconds,timezone,timezone_abbreviation"
    text = f"{above}\n50.8,4.4,50.0,0,{told},CET\n\n{table.to_csv(index=False)}"
    (tmp_path / "weather.csv").write_text(text, encoding="utf-8")
    (tmp_path / "map.yaml").write_text(starting_map(tmp_path / "weather.csv"), encoding="utf-8")
    assert tf.read_measurements(tmp_path / "weather.csv", tmp_path / "map.yaml").record.stamps()[0] == HOUSE.index[0]


def test_commas_within_all_numbers_part_nothing(tmp_path):
    """A spreadsheet's days since 1899 with decimal commas, as no other column has fewer."""
    df = HOUSE[["living", "out"]].rename(columns={"living": "Raum", "out": "Außen"}).reset_index(drop=True)
    df.insert(0, "Zeit", (HOUSE.index.tz_localize(None) - pd.Timestamp("1899-12-30")) / pd.Timedelta("1D") + 1e-6)
    df.to_csv(tmp_path / "q.csv", sep=";", decimal=",", index=False, float_format="%.6f", encoding="utf-8")
    (tmp_path / "map.yaml").write_text(starting_map(tmp_path / "q.csv"), encoding="utf-8")
    record = tf.read_measurements(tmp_path / "q.csv", tmp_path / "map.yaml").record
    np.testing.assert_allclose(record.T_zone_C[0, :200], HOUSE["living"].to_numpy()[:200], atol=0.01)


def test_stamps_without_a_year_are_of_the_year_that_the_map_says(tmp_path):
    """EnergyPlus: ' 12/30  24:00:00' is midnight at the end of that day; the record goes over New Year."""
    ends = pd.date_range("2025-12-29 00:15", periods=N, freq="15min")
    stamps = [
        f" {t:%m/%d}  {t:%H:%M:%S}" if t.hour or t.minute else f" {t - pd.Timedelta('1h'):%m/%d}  24:00:00"
        for t in ends
    ]
    names = {
        "living": "ZONE ONE:Zone Mean Air Temperature [C](TimeStep)",
        "out": "Environment:Site Outdoor Air Drybulb Temperature [C](TimeStep)",
    }
    names |= {"bath": "BATH:Zone Mean Air Temperature [C](TimeStep)"}
    names |= {"v_bath": "BATH BASEBOARD:Baseboard Total Heating Rate [W](TimeStep)"}
    names |= {"power": "Electricity:Facility [J](TimeStep)"}
    df = HOUSE[list(names)].rename(columns=names).set_axis(pd.Index(stamps, name="Date/Time"))
    df.to_csv(tmp_path / "eplusout.csv")
    text = starting_map(tmp_path / "eplusout.csv")
    assert "year: 2017  # CHECK" in text
    assert "marks: end  # CHECK: days end at 24:00" in text
    read = yaml.safe_load(text)
    assert list(read["zones"]) == ["zone_one", "bath"]
    assert {one["zone"]: one["heat"]["column"] for one in read["actuators"].values()} == {"bath": names["v_bath"]}
    assert [one["power"]["column"] for one in read["machines"].values()] == [names["power"]]
    (tmp_path / "map.yaml").write_text(text.replace("year: 2017", "year: 2025"), encoding="utf-8")
    found = tf.read_measurements(tmp_path / "eplusout.csv", tmp_path / "map.yaml")
    assert str(found.record.stamps()[-1])[:16] == "2026-01-02 00:00"
    np.testing.assert_allclose(found.record.T_out_C[-1], HOUSE["out"].iloc[-1])


@pytest.mark.parametrize("begins", ["2026-03-28", "2026-10-24"])
@pytest.mark.parametrize("first", ["rooms", "valves"])
def test_loggers_with_and_without_summer_time_have_a_zone_each(begins, first, tmp_path):
    """Written alike, by two clocks: with one zone for both an hour would lie between them from the change on."""
    at = pd.date_range(begins, periods=N // 2, freq="15min", tz="Etc/GMT-1")
    df = HOUSE.iloc[: N // 2].set_axis(at)
    tables = {
        "rooms": df[["living", "out"]].set_axis(at.strftime("%d.%m.%Y %H:%M")),
        "valves": df[["v_living"]].set_axis(at.tz_convert(ZONE).strftime("%d.%m.%Y %H:%M")),
    }
    files = [tmp_path / f"{name}.csv" for name in sorted(tables, reverse=first == "valves")]
    for name, table in tables.items():
        table.rename(columns={"living": "Zimmer", "out": "Außen", "v_living": "Ventil"}).to_csv(
            tmp_path / f"{name}.csv", sep=";", index_label="Zeit"
        )
    text = starting_map(files)
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    record = tf.read_measurements(files, tmp_path / "map.yaml").record
    np.testing.assert_allclose(record.T_zone_C[0], df["living"])
    np.testing.assert_allclose(record.u[0], df["v_living"].iloc[:-1] / 100.0)


@pytest.mark.parametrize("day", ["%d.%m.%Y", "%m/%d/%Y", "%Y-%m-%d", "%d-%b-%Y"])
def test_a_day_that_ends_at_24_is_midnight_of_the_next(day, tmp_path):
    ends = pd.date_range("2025-01-30 00:15", periods=N, freq="15min")
    hours = [f"{t:%H:%M}" if t.hour or t.minute else "24:00" for t in ends]
    days = (ends - pd.Timedelta("1min")).strftime(day)
    df = HOUSE[["living", "out"]].set_axis(pd.Index([f"{d} {h}" for d, h in zip(days, hours, strict=True)], name="t"))
    df.to_csv(tmp_path / "load.csv")
    (tmp_path / "map.yaml").write_text(starting_map(tmp_path / "load.csv"), encoding="utf-8")
    found = tf.read_measurements(tmp_path / "load.csv", tmp_path / "map.yaml")
    assert found.map.time.marks == "end"
    assert found.record.stamps()[-1].tz_localize(None) == ends[-1]
    assert found.record.n_steps == N - 1


@pytest.mark.parametrize(("price", "currency"), [("spot price SEK/kWh", "SEK"), ("spot price", "")])
def test_a_first_map_has_the_currency_that_a_column_of_prices_names(price, currency, tmp_path):
    df = HOUSE[["living", "out", "v_living", "power"]].assign(**{price: np.resize([0.8, 1.4], N)})
    df.rename(columns={"v_living": "living valve", "power": "heat pump power"}).to_csv(tmp_path / "log.csv")
    (tmp_path / "map.yaml").write_text(starting_map(tmp_path / "log.csv"), encoding="utf-8")
    assert tf.read_measurements(tmp_path / "log.csv", tmp_path / "map.yaml").map.currency == currency


@pytest.mark.parametrize(
    ("unit", "watts"),
    [("kBTU/h", 293.071), ("ton", 3516.85), ("kcal/h", 1.163), ("MJ/h", 277.778), ("MMBTU/h", 293071.0)],
)
def test_units_of_energy_exports_are_watts(unit, watts):
    power = HOUSE["power"].to_numpy() / watts
    df = pd.DataFrame({"room": HOUSE["living"], "out": HOUSE["out"], "p": power}, index=HOUSE.index)
    rules = {"outdoor": "out", "zones": {"room": {"temperature": "room"}}}
    rules |= {"machines": {"m": {"power": {"column": "p", "unit": unit}}}}
    record = tf.read_measurements(df, rules).record
    np.testing.assert_allclose(record.power_W[0], HOUSE["power"].iloc[: record.power_W.shape[1]], rtol=1e-4)


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


def test_a_column_called_room_that_holds_temperatures_names_no_signals(tmp_path):
    """In a table of readings it is the number of a room, such as 1.04 in an office."""
    at = HOUSE.index[:96].strftime("%Y-%m-%d %H:%M")
    wide = pd.DataFrame(
        {"time": at, "room": (2 * HOUSE["living"].iloc[:96]).round() / 2, "outdoor": HOUSE["out"].iloc[:96].round()}
    )
    wide.to_csv(tmp_path / "wide.csv", index=False)
    written = starting_map(tmp_path / "wide.csv")
    assert "outdoor: {column: outdoor" in written
    assert "temperature: {column: room" in written
    kinds = {1.04: HOUSE["living"], 2.11: HOUSE["living"] + 1.0}
    rows = [
        pd.DataFrame({"time": at, "room": room, "temperature": T_C.iloc[:96].round(1)}) for room, T_C in kinds.items()
    ]
    pd.concat(rows).sort_values("time", kind="stable").to_csv(tmp_path / "long.csv", index=False)
    assert "point: room, value: temperature" in starting_map(tmp_path / "long.csv")


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M", "%Y-%m-%dT%H:%MZ"])
@pytest.mark.parametrize("warm", [(6, 22), (22, 6)])
def test_set_points_that_are_lowered_each_night_are_bounds_by_the_hour(tmp_path, form, warm):
    """By the building's clock; without them a plan keeps a room warm all night that people let cool."""
    at = pd.date_range("2026-01-12", periods=N, freq="15min", tz=ZONE)
    hour = np.roll(np.arange(24), -warm[0])[: (warm[1] - warm[0]) % 24]
    asked = np.where(np.isin(at.hour, hour), 21.0, 18.0)
    asked[200:206] = 23.0  # somebody turned it for an evening
    stamps = at.strftime(form) if "Z" not in form else at.tz_convert("UTC").strftime(form)
    table = pd.DataFrame({"Zeit": stamps, "Zimmer °C": HOUSE["living"].array, "Zimmer Soll °C": asked})
    table["Bad °C"], table["Außen °C"] = HOUSE["bath"].array, HOUSE["out"].array
    table.to_csv(tmp_path / "house.csv", index=False)
    text = starting_map(tmp_path / "house.csv")
    expected = f"{warm[0]}-{warm[1]} 20.5-24, else 17.5-24"
    assert yaml.safe_load(text)["comfort"]["schedule"] == {"zimmer": expected, "bad": "else 20-24"}
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    found = tf.read_measurements(tmp_path / "house.csv", tmp_path / "map.yaml")
    lower = found.conditions.lower_C[0]
    np.testing.assert_array_equal(lower, np.where(np.isin(at.hour, hour), 20.5, 17.5)[: lower.size])


@pytest.mark.parametrize(
    ("weekend", "days", "expected"),
    [
        ((8, 23), 14, "weekdays 6-22 20.5-24, weekend 8-23 20.5-24, else 17.5-24"),
        ((0, 0), 14, "weekdays 6-22 20.5-24, else 17.5-24"),  # an office
        ((6, 22), 14, "6-22 20.5-24, else 17.5-24"),
        ((8, 23), 7, "6-22 20.5-24, else 17.5-24"),  # one weekend is none yet
    ],
)
def test_weekends_have_hours_of_their_own_where_people_set_other_ones(tmp_path, weekend, days, expected):
    at = pd.date_range("2026-01-12", periods=48 * days, freq="30min")
    begin, end = (np.where(at.day_of_week >= 5, *both) for both in zip(weekend, (6, 22), strict=True))
    asked = np.where((at.hour >= begin) & (at.hour < end), 21.0, 18.0)
    table = pd.DataFrame({"time": at.strftime("%Y-%m-%d %H:%M"), "room setpoint": asked})
    table["room temperature"], table["outdoor"] = 20 + np.arange(len(at)) % 9 / 5, np.arange(len(at)) % 50 / 9
    table.to_csv(tmp_path / "house.csv", index=False)
    schedule = yaml.safe_load(starting_map(tmp_path / "house.csv"))["comfort"]["schedule"]
    assert schedule == {"room": expected}
    (lower,), _ = Comfort(schedule=schedule).bounds_at(at, ["room"])
    if days > 7:
        np.testing.assert_array_equal(lower, asked - 0.5)


HOURS_IN_UTC = {"offsets": "%Y-%m-%dT%H:%M:%SZ", "header": "%Y-%m-%d %H:%M", "other offsets": "%Y-%m-%dT%H:%M:%S%z"}


@pytest.mark.parametrize("long", [False, True])
@pytest.mark.parametrize("how", HOURS_IN_UTC)
def test_comfort_by_the_hour_is_of_the_building_s_clock(tmp_path, how, long):
    """Home Assistant and InfluxDB write in UTC: 6 to 22 h in New York were 11 to 3 h, and nothing was said of it."""
    zone = "America/New_York"
    at = pd.date_range("2026-01-12", periods=N, freq="15min", tz=zone)
    stamps = (at if how == "other offsets" else at.tz_convert("UTC")).strftime(HOURS_IN_UTC[how])
    table = pd.DataFrame({"room temperature": HOUSE["living"].array, "outdoor": HOUSE["out"].array})
    table["room setpoint"] = np.where((at.hour >= 6) & (at.hour < 22), 21.0, 18.0)
    table.insert(0, "time (UTC)" if how == "header" else "time", stamps)
    if long:
        table = table.melt(table.columns[0], var_name="name")
    table.to_csv(tmp_path / "house.csv", index=False)
    text = starting_map(tmp_path / "house.csv", zone)
    assert yaml.safe_load(text)["comfort"]["schedule"] == {"room": "6-22 20.5-24, else 17.5-24"}
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    found = tf.read_measurements(tmp_path / "house.csv", tmp_path / "map.yaml")
    assert found.record.stamps()[0] == at[0]
    np.testing.assert_array_equal(found.conditions.lower_C[0], np.where((at.hour >= 6) & (at.hour < 22), 20.5, 17.5))
    untold = starting_map(tmp_path / "house.csv")
    if how == "other offsets":  # told by the stamps
        assert yaml.safe_load(untold)["comfort"] == yaml.safe_load(text)["comfort"]
        return
    assert "in these hours of UTC, not of the building's clock" in untold
    assert doubt_of_zone(untold).startswith("time.zone of the map is UTC: the stamps are in UTC, and so are all hours")
    assert not doubt_of_zone(text)
    (tmp_path / "map.yaml").write_text(untold, encoding="utf-8")
    assumed = tf.read_measurements(tmp_path / "house.csv", tmp_path / "map.yaml").understood.assumed
    assert any("hours of comfort are of UTC" in told for told in assumed)
    with pytest.raises(DataError, match="no time zone 'New York', did you mean"):
        starting_map(tmp_path / "house.csv", "New York")


@pytest.mark.parametrize("rooms", [("Floor 1 Room 2", "Floor 2 Room 1"), ("Bad 1. OG", "Zone #1")])
def test_rooms_whose_names_share_their_words_have_their_own_valves_and_setpoints(tmp_path, rooms):
    table = pd.DataFrame(
        {"time": HOUSE.index[:96].strftime("%Y-%m-%d %H:%M"), "outdoor": HOUSE["out"].iloc[:96].values}
    )
    for room in rooms:
        table[f"{room} temperature"] = HOUSE["living"].iloc[:96].values
        table[f"{room} valve"] = np.arange(96) // 8 % 2 * 100.0
        table[f"{room} setpoint"] = 21.0 + np.arange(96) // 48
    table.to_csv(tmp_path / "house.csv", index=False)
    found = yaml.safe_load(starting_map(tmp_path / "house.csv"))
    read = {of["zone"]: (of["level"]["column"], of["command"]["column"]) for of in found["actuators"].values()}
    columns = {zone: of["temperature"]["column"].removesuffix(" temperature") for zone, of in found["zones"].items()}
    assert read == {zone: (f"{room} valve", f"{room} setpoint") for zone, room in columns.items()}
    assert set(columns.values()) == set(rooms)


@pytest.mark.parametrize(("apart_K", "zones"), [(0.05, 1), (0.2, 2)])
def test_a_sensor_that_a_thermostat_shows_again_is_no_second_room(tmp_path, apart_K, zones):
    """ecobee: 'Current Temp' is that of the thermostat where it has no other sensor, stored a little later here."""
    table = pd.DataFrame({"time": HOUSE.index.strftime("%Y-%m-%d %H:%M:%S"), "Outdoor Temp": HOUSE["out"].array})
    table["Current Temp"] = HOUSE["living"].array + apart_K
    table["Thermostat Temperature"] = HOUSE["living"].array
    later = table.copy()
    later["time"] = (HOUSE.index + pd.Timedelta("20s")).strftime("%Y-%m-%d %H:%M:%S")
    table["Thermostat Temperature"], later[["Current Temp", "Outdoor Temp"]] = np.nan, np.nan
    pd.concat([table, later]).sort_values("time").to_csv(tmp_path / "report.csv", index=False)
    text = starting_map(tmp_path / "report.csv")
    assert len(yaml.safe_load(text)["zones"]) == zones
    assert ("Current Temp (the same readings as Thermostat Temperature)" in text) is (zones == 1)


@pytest.mark.parametrize("apart_K", [0.05, 0.2])
def test_a_sensor_under_a_second_name_is_no_neighbour(apart_K):
    """ecobee: the check said of the map that was proposed that a heated room stands outside of it."""
    table = HOUSE[["living", "out"]].rename(columns={"living": "thermostat temperature"})
    table["current temp"] = table["thermostat temperature"] + apart_K
    rules = {"outdoor": "out", "zones": {"room": {"temperature": "thermostat temperature"}}}
    said = tf.read_measurements(table, rules).understood.beside
    assert any("current temp looks like a room" in one for one in said) is (apart_K > 0.1)


def test_a_line_of_the_line_protocol_without_its_time_is_refused(tmp_path):
    path = tmp_path / "dump.lp"
    path.write_text(
        "temperature,room=living value=21.3 1736726400000000000\n" * 3 + "temperature,room=living value=2\n"
    )
    with pytest.raises(DataError, match=r"dump\.lp, line 4: has no time, as in 'measurement,tag=a"):
        starting_map(path)


def test_signals_of_programs_with_tags_of_their_own_are_named_by_these(tmp_path):
    """Telegraf: a topic of a broker, a plug's device, the computer: of those without a topic the names were lost."""
    lines = []
    for k, at in enumerate(HOUSE.index.as_unit("ns").asi8):
        lines += [
            f"mqtt,host=pi,topic=home/living temperature={HOUSE['living'].iloc[k]},humidity=45i {at}",
            f"mqtt,host=pi,topic=home/outdoor temperature={HOUSE['out'].iloc[k]} {at}",
            f"shelly,host=pi,device=heatpump apower={HOUSE['power'].iloc[k]},output={'t' if k % 9 < 4 else 'f'} {at}",
            f"cpu,host=pi,cpu=cpu-total usage_idle=93.2 {at}",
        ]
    (tmp_path / "dump.lp").write_text("\n".join(lines))
    rules = yaml.safe_load(starting_map(tmp_path / "dump.lp"))
    assert rules["outdoor"]["column"] == "home/outdoor temperature"
    assert rules["machines"]["machine"]["power"]["column"] == "heatpump apower"
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(rules))
    record = tf.read_measurements(tmp_path / "dump.lp", tmp_path / "map.yaml").record
    np.testing.assert_array_equal(record.power_W[0], HOUSE["power"].to_numpy()[:-1])
    np.testing.assert_array_equal(record.u[0], np.arange(N - 1) % 9 < 4)


def ours_of(tmp_path, columns: dict[str, object]) -> dict[str, dict[str, object]]:
    """The map that is written for a table of some columns over the days of the house."""
    table = pd.DataFrame({"time": local("%Y-%m-%d %H:%M")} | {k: np.asarray(v) for k, v in columns.items()})
    table.to_csv(tmp_path / "house.csv", index=False)
    return yaml.safe_load(starting_map(tmp_path / "house.csv"))


def set_by(low: float) -> np.ndarray:
    return np.where((np.arange(N) // 4 + 1) % 24 < 7, low, low + 3.0)


def test_actual_and_target_of_evohome_are_not_exchanged(tmp_path):
    """'Bath [T]' was taken for the bath's temperature, 'Bath [A]' for amperes."""
    columns = {"Living [A]": HOUSE["living"], "Living [T]": set_by(18), "Bath [A]": HOUSE["bath"]}
    rules = ours_of(tmp_path, columns | {"Bath [T]": np.full(N, 22.5), "Outside": HOUSE["out"]})
    assert [one["temperature"]["column"] for one in rules["zones"].values()] == ["Living [A]", "Bath [A]"]
    assert rules["comfort"]["schedule"]["living"] == "7-24 20.5-24, else 17.5-24"
    assert tf.read_measurements(tmp_path / "house.csv", rules).understood.beside == ()


def test_a_t_behind_a_word_is_a_temperature(tmp_path):
    """heatpumpmonitor.org: heatpump_outsideT was the level of an actuator that heats and cools."""
    columns = {"heatpump_elec": HOUSE["power"], "heatpump_flowT": 30 + HOUSE["v_bath"] / 10}
    rules = ours_of(tmp_path, columns | {"heatpump_outsideT": HOUSE["out"], "heatpump_roomT": HOUSE["living"]})
    assert rules["outdoor"]["column"] == "heatpump_outsideT"
    assert [one["temperature"]["column"] for one in rules["zones"].values()] == ["heatpump_roomT"]
    assert "level" not in next(iter(rules["actuators"].values()))


def test_counters_of_two_tariffs_are_one_meter_and_an_export_is_none(tmp_path):
    """A Dutch meter (HomeWizard): the still counter of exports was taken for 1285 kWh in each step, 5 MW."""
    night = np.arange(N) // 4 % 24 < 7
    counted = {k: 9000 + np.cumsum(HOUSE["power"] / 4000 * (night == (k == 2))) for k in (1, 2)}
    columns = {"T room": HOUSE["living"], "outdoor": HOUSE["out"]} | {f"Import T{k} kWh": counted[k] for k in (1, 2)}
    rules = ours_of(tmp_path, columns | {"Export T1 kWh": np.full(N, 1285.951), "L1 max W": HOUSE["power"] + 260})
    power = rules["machines"]["machine"]["power"]
    assert power == {"column": ["Import T1 kWh", "Import T2 kWh"], "unit": "kWh counter"}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(rules))
    record = tf.read_measurements(tmp_path / "house.csv", tmp_path / "map.yaml").record
    np.testing.assert_allclose(record.power_W[0, 2:-2], HOUSE["power"].to_numpy()[3:-2], atol=1.0)


def test_a_unit_above_readings_is_that_of_all(tmp_path):
    """Green Button: the energy of each quarter of an hour was read as kW, a quarter of the power."""
    rows = ["TYPE,DATE,START TIME,END TIME,USAGE (kWh),COST,NOTES"]
    for k, t in enumerate(HOUSE.index):
        end = t + pd.Timedelta("14min")
        rows.append(f"Electric usage,{t:%Y-%m-%d},{t:%H:%M},{end:%H:%M},{HOUSE['power'].iloc[k] / 4000:.3f},$0.12,")
    (tmp_path / "usage.csv").write_text("Name,J DOE\nService,Electric Service\n\n" + "\n".join(rows))
    rooms = pd.DataFrame({"Indoor": HOUSE["living"].array, "Outdoor": HOUSE["out"].array})
    rooms.set_axis(HOUSE.index.strftime("%Y-%m-%d %H:%M")).to_csv(tmp_path / "rooms.csv", index_label="time")
    rules = yaml.safe_load(starting_map([tmp_path / "rooms.csv", tmp_path / "usage.csv"]))
    assert rules["machines"]["machine"]["power"] == {"column": "Electric usage", "unit": "kWh per step"}


@pytest.mark.parametrize("at", ["/Server 1/AHU/{}/{} TL", "{}-measure {}"])
def test_what_all_signals_are_called_says_of_none_where_it_is(tmp_path, at):
    """A server's folders (EcoStruxure) hid valves, a word of all (Homey) gave each room the heat pump's meter."""
    columns: dict[str, object] = {at.format("HP1", "Elec Power (W)"): HOUSE["power"]}
    for room, name in (("R101", "living"), ("R102", "bath")):
        columns |= {at.format(room, "Space Temp (°C)"): HOUSE[name], at.format(room, "Valve (%)"): HOUSE[f"v_{name}"]}
    rules = ours_of(tmp_path, columns | {at.format("Weather", "OAT (°C)"): HOUSE["out"]})
    assert list(rules["machines"]) == ["machine"]
    levels = {one["zone"]: one["level"]["column"] for one in rules["actuators"].values()}
    temperatures = {zone: one["temperature"]["column"] for zone, one in rules["zones"].items()}
    for room in ("R101", "R102"):
        (zone,) = (zone for zone, column in temperatures.items() if room in column)
        assert levels[zone] == at.format(room, "Valve (%)")
    del columns[at.format("R101", "Valve (%)")], columns[at.format("R102", "Valve (%)")]
    assert list(ours_of(tmp_path, columns | {at.format("Weather", "OAT (°C)"): HOUSE["out"]})["machines"]) == [
        "machine"
    ]


def test_rows_of_devices_with_several_readings_become_a_file_of_each_as_is_said(tmp_path, monkeypatch):
    """A dump of Domoticz or of a logger's database: the rooms were one, of all their readings in turn."""
    monkeypatch.chdir(tmp_path)
    parts = [
        pd.DataFrame({"sensor": name, "temperature": HOUSE[name].array, "humidity": 45, "at": local("%Y-%m-%d %H:%M")})
        for name in ("living", "bath", "out")
    ]
    pd.concat(parts).sort_values("at", kind="stable").to_csv("dump.csv", index=False)
    with pytest.raises(DataError, match=r"each row is of one of 3 by column 'sensor', with several readings") as told:
        starting_map("dump.csv")
    exec(str(told.value).split('python -c "')[1].removesuffix('"'), {})
    rules = yaml.safe_load(starting_map(["living.csv", "bath.csv", "out.csv"]))
    assert rules["outdoor"]["column"] == "out temperature"
    assert [one["temperature"]["column"] for one in rules["zones"].values()] == [
        "living temperature",
        "bath temperature",
    ]


def test_a_word_in_one_cell_of_a_long_table_does_not_hide_the_signal(tmp_path):
    files = fhem(tmp_path)
    text = files[0].read_text().replace("Aussen;CUL_HM;temperature;3.0", "Aussen;CUL_HM;temperature;sensor lost", 1)
    assert "sensor lost" in text
    files[0].write_text(text)
    written = starting_map(files)
    assert "missing: [sensor lost]}  # CHECK: words for an empty cell?" in written
    (tmp_path / "map.yaml").write_text(written)
    outdoors = tf.read_measurements(files, tmp_path / "map.yaml").record.T_out_C
    assert np.isnan(outdoors).sum() < 3
    assert np.nanmax(np.abs(outdoors - HOUSE["out"].to_numpy()[: outdoors.size])) < 1.0


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("h.json", '[[{"entity_id": "sensor.a", "state": "21.3"}' + ', {"state": "1"}' * 9000 + "]]", "is JSON, no"),
        ("h.csv", "<!DOCTYPE html><html><body>Log in</body></html>", "is a page of the web"),
        ("h.xml", '<?xml version="1.0"?><Statistics/>', "is XML"),
        ("h.csv", "2026-01-12 01:00,21.0,3.1\n2026-01-12 01:15,21.1,3.0\n", "its first line is a reading"),
        ("h.csv", "".join(f"{1768176000 + 900 * k},21.{k}\n" for k in range(9)), "first line.*such as 'time,value'"),
        ("h.csv", "".join(f"2026-01-12T01:0{k}:00Z,a/temp,3.{k}\n" for k in range(9)), "such as 'time,topic,value'"),
        ("h.log", "2026-01-12T01:00:01 WP temp: 21.0\n2026-01-12T01:09:00 WP temp: 21.1\n", "nothing parts the cells"),
        (
            "h.csv",
            "entity_id,type,unit," + ",".join(f"2026-01-12T{h:02d}:00:00.000Z" for h in range(24)) + "\n"
            "sensor.heat_pump,device_consumption,kWh" + ",0.5" * 24 + "\n",
            "its times stand side by side",
        ),
        (
            "h.csv",
            "oat Date,oat,rm1 Date,rm1\n" + "".join(
                f"01/12/26 {k // 60:02d}:{k % 60:02d},{k},01/12/26 {(k + 3) // 60:02d}:{(k + 3) % 60:02d},20.5\n"
                for k in range(0, 900, 15)
            ),
            "2 trends side by side",
        ),
    ],
)  # fmt: skip
def test_what_is_no_table_is_told_with_what_to_do(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(DataError, match=said):
        starting_map(tmp_path / name)


def test_times_side_by_side_are_turned_round_as_is_said(tmp_path, monkeypatch):
    """Home Assistant's energy dashboard: the remedy of the message gives a table."""
    times = [f"2026-01-12T{h:02d}:00:00.000Z" for h in range(24)]
    rows = ["entity_id,type,unit," + ",".join(times), "sensor.hp,device_consumption,kWh" + ",0.5" * 24]
    (tmp_path / "energy.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(DataError) as told:
        starting_map(tmp_path / "energy.csv")
    monkeypatch.chdir(tmp_path)
    exec(str(told.value).split('python -c "')[1].removesuffix('"'))
    turned = pd.read_csv("turned.csv")
    assert list(turned.columns) == ["time", "sensor.hp"]
    assert list(turned["time"]) == times


OF_PROGRAMS = {
    "loxone.xml": (
        '<?xml version="1.0" encoding="utf-8"?>\n<Statistics Name="Bad Temperatur" NumOutputs="1" Outputs="AQ">\n',
        '<S T="{t:%Y-%m-%d %H:%M:%S}" V="{T:.3f}"/>\n', "</Statistics>\n", "Bad Temperatur",
    ),
    "item.json": (
        '{{"name":"Bad_Temperatur","datapoints":"96","data":[', '{{"time":{ms},"state":"{T:.1f} °C"}}{comma}', "]}}",
        "Bad_Temperatur",
    ),
    "log.json": ("", '{{"topic":"Bad Temperatur","payload":{T:.1f},"ts":{ms}}}\n', "", "Bad Temperatur"),
    "fhem-2026-01.log": (
        "", "{t:%Y-%m-%d_%H:%M:%S} Bad temperature: {T:.1f} °C\n{t:%Y-%m-%d_%H:%M:%S} Bad set on\n"
        "{t:%Y-%m-%d_%H:%M:%S} Bad humidity: 4{k}\n", "", "Bad temperature",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", OF_PROGRAMS)
def test_what_programs_write_that_is_no_table_becomes_one_as_is_said(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    begins, row, ends, column = OF_PROGRAMS[name]
    at = pd.date_range("2026-01-12", periods=96, freq="15min", tz="UTC")
    rows = [
        row.format(t=t, k=k % 9, ms=t.as_unit("ms").value, T=20 + 0.1 * (k % 7), comma="," * (k < 95))
        for k, t in enumerate(at)
    ]
    Path(name).write_text(begins.format() + "".join(rows) + ends.format(), encoding="utf-8")
    with pytest.raises(DataError, match=r"no table\. Make one of it") as told:
        starting_map(Path(name))
    exec(str(told.value).split('python -c "')[1].removesuffix('"'), {})
    rules = yaml.safe_load(starting_map(next(Path().glob("*.csv"))))
    (zone,) = rules["zones"].values()
    assert zone["temperature"]["column"] == column


@pytest.mark.parametrize(
    "stamp",
    ["{t.day} mars {t.year} kl. {t:%H:%M}", "March {t.day}, {t.year} at {t:%I:%M %p}",
     "{t.day}. maj {t.year} kl. {t:%H.%M}",
     "{t:%Y-%m-%dT%H:%M:%S}+01:00[Europe/Berlin]"],
)  # fmt: skip
def test_words_and_zones_in_stamps_are_read(tmp_path, stamp):
    at = pd.date_range("2026-05-05" if "maj" in stamp else "2026-03-05", periods=96, freq="15min")
    df = pd.DataFrame({"T room (°C)": HOUSE["living"].to_numpy()[:96], "T out (°C)": HOUSE["out"].to_numpy()[:96]})
    df.insert(0, "Time", [stamp.format(t=t) for t in at])
    df.to_csv(tmp_path / "h.csv", index=False)
    (tmp_path / "map.yaml").write_text(starting_map(tmp_path / "h.csv"))
    record = tf.read_measurements(tmp_path / "h.csv", tmp_path / "map.yaml").record
    assert record.stamps()[4].tz_localize(None) == at[4]
    assert record.n_steps == 95


def test_a_format_that_is_still_to_be_filled_in_is_said():
    with pytest.raises(ConfigError, match="'FILL IN' has no %"):
        tf.read_measurements(pd.DataFrame({"t": ["1"], "T": [1.0]}), {"time": {"format": "FILL IN"}, "outdoor": "T",
            "zones": {"r": {"temperature": "T"}}})  # fmt: skip


def test_files_of_two_programs_hold_by_their_own_marks_and_clocks(tmp_path):
    """Rooms by a pattern with decimal commas; the meter's stamps are ends of quarters of an hour in UTC."""
    df = HOUSE[["living", "out", "v_living"]].reset_index(drop=True)
    df.insert(0, "Zeit", local("%d.%m.%Y %H:%M"))
    df.to_csv(tmp_path / "raum 1.csv", sep=";", decimal=",", index=False)
    ends = (HOUSE.index + pd.Timedelta("15min")).strftime("%Y-%m-%dT%H:%M:%SZ")
    HOUSE[["power"]].set_axis(ends).to_csv(tmp_path / "zaehler.csv", index_label="Horodate")
    rules = {
        "time": {"zone": ZONE, "format": "%d.%m.%Y %H:%M"}, "csv": {"decimal": ","}, "outdoor": "out",
        "files": {"zaehler*": {"csv": {}, "time": {"marks": "end", "zone": "UTC"}}},
        "zones": {"r": {"temperature": "living"}}, "actuators": {"v": {"level": {"column": "v_living", "unit": "%"}}},
        "machines": {"m": {"power": "power", "price": 0.3}},
    }  # fmt: skip
    record = tf.read_measurements(sorted(tmp_path.glob("*.csv")), rules).record
    truth = HOUSE.reindex(record.stamps().tz_convert("UTC"))
    np.testing.assert_allclose(record.T_zone_C[0][1:-2], truth["living"].to_numpy()[1:-2])
    np.testing.assert_allclose(record.power_W[0][1:-2], truth["power"].to_numpy()[:-1][1:-2])
    lenient = tf.read_measurements(sorted(tmp_path.glob("*.csv")), rules, now=HOUSE.index[-1])
    np.testing.assert_allclose(
        lenient.record.power_W[0][1:-2], truth["power"].to_numpy()[:-1][1:-2][: lenient.record.n_steps]
    )


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


def test_a_heat_meter_tells_what_is_paid_for_where_no_power_is_metered(tmp_path):
    """District heat: nothing could be planned, though its meter is the one that bills it."""
    rows = HOUSE[["living", "out"]].set_axis(["Wohnzimmer [°C]", "Außentemperatur [°C]"], axis=1)
    rows["Wärmemenge WMZ [kWh]"] = np.round(20000.0 + np.cumsum(HOUSE["v_living"]) * 7.0 / 400.0, 2)
    file = tmp_path / "district.csv"
    rows.to_csv(file, sep=";", decimal=",", index_label="Zeitstempel")
    text = starting_map([file])
    (tmp_path / "map.yaml").write_text(text)
    assert re.search(r"power: \{column: 'Wärmemenge WMZ .*CHECK: heat, as no electric power", text)
    measured = tf.read_measurements(file, tmp_path / "map.yaml")
    assert measured.record.power_W.max() == pytest.approx(7000.0, rel=0.02)
    rows["WP Leistung [kW]"] = HOUSE["power"] / 1000.0
    rows.to_csv(file, sep=";", decimal=",", index_label="Zeitstempel")
    assert "power: {column: 'WP Leistung [kW]'" in starting_map([file])


@pytest.mark.parametrize(
    "codes",
    [
        {"living": -127.0, "out": 85.0, "power": 65535.0},
        {"living": 3276.7, "out": -999.0, "power": -9999.0},
        {"living": 3.4e38, "out": -99.9, "power": 32767.0},
    ],
)
def test_codes_for_no_reading_hide_no_signal(tmp_path, codes):
    df = HOUSE[["living", "out", "v_living", "power"]].rename(columns={"v_living": "valve"})
    table = tmp_path / "house.csv"
    df.to_csv(table, index_label="time")
    plain = starting_map(table)
    for name, code in codes.items():
        df.loc[df.index[[7, 8, 200]], name] = code
    df.to_csv(table, index_label="time")
    assert starting_map(table) == plain


def test_a_counter_that_began_anew_is_one(tmp_path):
    df = HOUSE[["living", "out", "v_living"]].rename(columns={"v_living": "valve"})
    counted = 4.0 * HOUSE["power"].cumsum().round()
    df["energy Wh"] = counted.where(np.arange(N) < 150, counted - counted.iloc[149])
    df.to_csv(tmp_path / "house.csv", index_label="time")
    assert "power: {column: energy Wh, unit: 'Wh counter'}" in starting_map(tmp_path / "house.csv")


def test_signals_that_influx_writes_one_after_the_other_are_told_apart_by_their_field(tmp_path):
    """The first 2000 rows are of one signal: asked and measured, of one entity of a thermostat, were one column."""
    at = pd.date_range("2026-01-12", periods=2100, freq="5min").strftime("%Y-%m-%dT%H:%M:%SZ")
    k = np.arange(2100)
    values = {"current_temperature": 20 + np.sin(k / 30), "temperature": 18 + 3.0 * (k // 144 % 2)}
    series = [
        pd.DataFrame({"_time": at, "_value": value, "_field": name, "_measurement": "climate", "entity_id": "hall"})
        for name, value in values.items()
    ]
    series.append(series[0].assign(_value=3 + k % 50 / 9, _field="value", entity_id="outdoor"))
    pd.concat(series).to_csv(tmp_path / "influx.csv", index=False)
    rules = yaml.safe_load(starting_map(tmp_path / "influx.csv"))
    assert rules["table"]["point"] == ["entity_id", "_field"]
    assert [one["temperature"]["column"] for one in rules["zones"].values()] == ["hall current_temperature"]
    assert rules["outdoor"]["column"] == "outdoor value"


def test_of_rows_with_the_newest_first_a_counter_is_one_and_hours_are_those_of_the_day(tmp_path):
    """A hub's log of events (Hubitat): times were turned round and readings not, so a counter was 48 MW of energy per
    step, and people were at home when they were not."""
    counted = 9000 + np.concatenate([[0.0], np.cumsum(HOUSE["power"].to_numpy() / 4000)[:-1]])
    of = {"temperature Room": HOUSE["living"], "temperature Outdoor": HOUSE["out"], "heatingSetpoint Room": set_by(18)}
    of |= {"energy Heat Pump": counted, "power Heat Pump": HOUSE["power"]}
    rows = [
        f"{device},{name},{values.iloc[k] if hasattr(values, 'iloc') else values[k]},{t}"
        for k, t in enumerate(local("%Y-%m-%d %H:%M:%S"))
        for (name, _, device), values in ((key.partition(" "), one) for key, one in of.items())
    ]
    texts = []
    for ordered in (rows, rows[::-1]):
        (tmp_path / "events.csv").write_text("\n".join(["Device,Name,Value,Date", *ordered]) + "\n")
        texts.append(starting_map(tmp_path / "events.csv"))
    assert texts[0] == texts[1]
    assert yaml.safe_load(texts[1])["machines"]["machine"]["power"]["column"] == "power Heat Pump"


@pytest.mark.parametrize("name", ["Heat pump L{} (W)", "3EM {} total (kWh)", "Heat pump W ({})"])
def test_three_phases_are_one_meter(tmp_path, name):
    """One phase of three was taken for all: a third of the power."""
    counter = np.concatenate([[0.0], np.cumsum(HOUSE["power"].to_numpy() / 4000)[:-1]]) / 3
    phase = 900 + counter if "kWh" in name else HOUSE["power"] / 3
    columns = [name.format(which) for which in ("123" if "L{}" in name else "abc")]
    rules = ours_of(tmp_path, {"Living": HOUSE["living"], "Outside": HOUSE["out"]} | dict.fromkeys(columns, phase))
    assert rules["machines"]["machine"]["power"]["column"] == columns
    record = tf.read_measurements(tmp_path / "house.csv", rules).record
    np.testing.assert_allclose(record.power_W[0, 2:-2], HOUSE["power"].to_numpy()[2:-3], atol=1.0)


@pytest.mark.parametrize(("other", "of_other"), [("Heat pump total (W)", True), ("Backup heater (W)", False)])
def test_a_total_stands_for_its_phases_and_another_machine_does_not(tmp_path, other, of_other):
    """A backup heater was the machine's meter, since it has no phases."""
    phases = {f"Heat pump L{k} (W)": HOUSE["power"] / 3 for k in (1, 2, 3)}
    rules = ours_of(tmp_path, {"Living": HOUSE["living"], "Outside": HOUSE["out"]} | phases | {other: HOUSE["power"]})
    assert rules["machines"]["machine"]["power"]["column"] == (other if of_other else list(phases))


@pytest.mark.parametrize(("room", "heater"), [("Room {} (°C)", "Heater {} power (W)"), ("L{} room", "Heater L{} (W)")])
def test_heaters_of_three_rooms_are_no_phases(tmp_path, room, heater):
    """Each room's meter was the sum of the heaters A, B and C of three rooms."""
    which = "ABC" if "{} power" in heater else "123"
    rooms = {room.format(one): HOUSE["living"] + k for k, one in enumerate(which)}
    heaters = {heater.format(one): np.roll(HOUSE["power"], 7 * k) for k, one in enumerate(which)}
    rules = ours_of(tmp_path, rooms | heaters | {"Outside": HOUSE["out"]})
    for machine in rules["machines"].values():
        assert isinstance(machine["power"]["column"], str)


@pytest.mark.parametrize("names", [["Heat pump (W)"], [f"Heat pump L{k} (W)" for k in (1, 2, 3)]])
def test_a_code_for_no_reading_of_power_is_none(tmp_path, names):
    """65535 W were read as such, 8 times the mean power, since a machine may take so much; so of one phase of three."""
    power = HOUSE["power"].to_numpy() / len(names)
    coded = power.copy()
    coded[::45] = 65535.0
    columns = dict.fromkeys(names, power) | {names[-1]: coded}
    rules = ours_of(tmp_path, {"Living": HOUSE["living"], "Outside": HOUSE["out"]} | columns)
    found = tf.read_measurements(tmp_path / "house.csv", rules)
    assert np.nanmax(found.record.power_W) <= HOUSE["power"].max()
    (flag,) = [flag for one in found.understood.signals for flag in one.flags]
    assert (flag.rule, flag.count) == ("code for no reading", len(power[::45]))


@pytest.mark.parametrize(
    ("name", "marks"),
    [("Interval end (UTC)", "end"), ("Date fin", "end"), ("time_end", "end"), ("Trend time", "start")],
)
def test_the_name_of_the_stamps_says_an_end(tmp_path, name, marks):
    frame = pd.DataFrame({name: local("%Y-%m-%d %H:%M"), "Living": HOUSE["living"].array})
    frame.assign(Outside=HOUSE["out"].array, Heating=HOUSE["power"].array).to_csv(tmp_path / "house.csv", index=False)
    assert yaml.safe_load(starting_map(tmp_path / "house.csv"))["time"]["marks"] == marks


@pytest.mark.parametrize("name", ["Frequency", "Grid frequency (Hz)"])
def test_the_frequency_of_the_mains_is_no_level(tmp_path, name):
    """It was that of a heater at 99.9 % of its largest."""
    mains = 50.0 + np.round(np.random.default_rng(1).normal(0.0, 0.03, len(HOUSE["out"])), 2)
    rules = ours_of(
        tmp_path, {"Living": HOUSE["living"], "Outside": HOUSE["out"], name: mains, "Heat pump (W)": HOUSE["power"]}
    )
    assert "level" not in rules["actuators"]["heater"]


def test_a_room_is_no_device_and_energy_of_a_quarter_no_level_without_a_doubt(tmp_path):
    """A column called Room was refused as one that names devices; kWh up to 0.6 were a level without a word."""
    columns = {"Room": HOUSE["living"], "Outside": HOUSE["out"], "Heat pump": (HOUSE["power"] / 4000).round(3)}
    rules = ours_of(tmp_path, columns)
    assert rules["zones"]["room"]["temperature"]["column"] == "Room"
    (level,) = [line for line in starting_map(tmp_path / "house.csv").splitlines() if "level: {column" in line]
    assert "CHECK" in level


def test_names_say_an_end_a_frequency_and_what_is_no_unit(tmp_path):
    frame = pd.DataFrame({"Intervallende": local("%Y-%m-%d %H:%M"), "Living": HOUSE["living"].array})
    frame = frame.assign(Outside=HOUSE["out"].array, Frequency=(HOUSE["v_living"] * 0.6).round().array)
    frame["Heat pump energy (Wmin)"] = np.cumsum(HOUSE["power"].to_numpy() * 15)
    frame.to_csv(tmp_path / "house.csv", index=False)
    text = starting_map(tmp_path / "house.csv")
    assert yaml.safe_load(text)["time"]["marks"] == "end"
    assert "CHECK: 'Wmin' is no unit that is known" in text
    assert "a frequency over its largest is a level" in text
    ours = ours_of(tmp_path, {"Living": HOUSE["living"], "Outside": HOUSE["out"], "Heat pump state": np.arange(N) % 4})
    assert next(iter(ours["actuators"].values()))["level"]["factor"] == pytest.approx(33.33)
