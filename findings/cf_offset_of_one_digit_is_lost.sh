#!/usr/bin/env bash
# The CF conventions' own example of a time, "seconds since 1992-10-8 15:15:42.5 -6:00", is six hours off in netCDF4 and in half of xarray.
#
# Versions: netCDF4 1.7.5.1.post1, cftime 1.6.6.1, xarray 2026.9.0, pandas 3.1.1; cf-units 3.3.1 (UDUNITS) in comparison
# A good guess: an offset in the units of a time is applied or refused, by all readers alike
# Seen: cftime, and so netCDF4's num2date, knows "-06:00" and passes over "-6:00", "-6" and "+1:00" without a word. xarray applies them for
# the usual calendar, and passes over them for the same file with use_cftime=True or where the calendar is "noleap". UDUNITS applies all
# Why it matters: a weather file in local time is right by one reader and hours off by another, or becomes wrong with the one option that
# is set to read a climate model's calendar: the sun rises at night, and a plan heats before the wrong morning
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile netCDF4==1.7.5.1.post1 cftime==1.6.6.1 xarray==2026.9.0 pandas==3.1.1 cf-units==3.3.1
cd "$work"
"$work/venv/bin/python" - <<'EOF'
import cf_units
import netCDF4
import pandas as pd
import xarray as xr


def hours_to_utc(units, calendar="standard"):
    """By how many hours each reader's first time is later than the clock that the units name."""
    clock = pd.Timestamp(units.split(" since ")[1].rpartition(" ")[0])
    with netCDF4.Dataset("weather.nc", "w") as file:
        file.createDimension("time", 2)
        file.createVariable("time", "f8", ("time",))[:] = [0.0, 1.0]
        file["time"].units, file["time"].calendar = units, calendar
    with netCDF4.Dataset("weather.nc") as file:
        seen = {"netCDF4": netCDF4.num2date(file["time"][0], units, calendar)}
    for name, kind in (("xarray", None), ("xarray, use_cftime", True)):
        with xr.open_dataset("weather.nc", decode_times=xr.coders.CFDatetimeCoder(use_cftime=kind)) as file:
            seen[name] = file["time"].values[0]
    hours = {name: (pd.Timestamp(str(at)) - clock) / pd.Timedelta(hours=1) for name, at in seen.items()}
    reference = cf_units.Unit(f"hours since {clock}", calendar=calendar)
    if calendar != "standard":  # UDUNITS knows no other
        return hours
    return hours | {"UDUNITS": round(cf_units.Unit(units, calendar=calendar).convert(0.0, reference), 6)}


def check(units, *expected, calendar="standard"):
    seen = hours_to_utc(units, calendar)
    print(units, f"({calendar}):", seen)
    assert tuple(seen.values()) == expected


check("hours since 2026-01-01 00:00:00 -06:00", 6, 6, 6, 6)
check("seconds since 1992-10-8 15:15:42.5 -6:00", 0, 6, 0, 6)
check("hours since 2026-01-01 00:00:00 -6", 0, 6, 0, 6)
check("hours since 2026-01-01 00:00:00 +1:00", 0, -1, 0, -1)
check("hours since 2026-01-01 00:00:00 -6:00", 0, 0, 0, calendar="noleap")
EOF
