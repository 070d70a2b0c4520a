#!/usr/bin/env bash
# pvlib and ladybug read one EPW file: they agree about the hour of the sun, and temperatures of pvlib are an hour earlier.
#
# Versions: ladybug-core 0.44.62, pvlib 0.16.1
# A good guess: both put the row of hour 1 at the same time, or all columns of it an hour apart (begin or end of the hour)
# Seen: radiation of hour 1 is at 0:00 in both. Its temperature, humidity and wind are at 1:00 in ladybug, since EPW has
# means over the hour for radiation and values at its end for the rest, and at 0:00 in pvlib
# Why it matters: a model of a building that is fitted to measured weather and run with a file's, or compared between two
# programs, has temperatures an hour early beside the right sun, and no check of the sun's hour tells
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile ladybug-core==0.44.62 pvlib==0.16.1
"$work/venv/bin/python" -W ignore - "$work/year.epw" <<'PY'
import sys

import pvlib
from ladybug.epw import EPW

file = sys.argv[1]
made = EPW.from_missing_values()
made.dry_bulb_temperature.values = [float(hour % 24) for hour in range(8760)]
made.relative_humidity.values = [50 + hour % 24 for hour in range(8760)]
made.wind_speed.values = [0.1 * (hour % 24) for hour in range(8760)]
made.global_horizontal_radiation.values = [10 * (hour % 24) for hour in range(8760)]
made.write(file)
rows = [line.split(",") for line in open(file).read().splitlines()[8:]]
hour_12 = rows[24 + 11]
assert hour_12[:5] == ["2017", "1", "2", "12", "0"], hour_12
print("the file, 2 January, hour 12: dry bulb", hour_12[6], "radiation", hour_12[13])

by_ladybug, (by_pvlib, _) = EPW(file), pvlib.iotools.read_epw(file)


def hour_of(column, value):
    """The hour of 2 January at which ladybug has what the file has in hour 12."""
    return next(at.hour for at, x in zip(column.datetimes[24:48], column.values[24:48]) if abs(x - value) < 1e-6)


day = by_pvlib.iloc[24:48]
for name, column, place in (
    ("ghi", by_ladybug.global_horizontal_radiation, 13),
    ("temp_air", by_ladybug.dry_bulb_temperature, 6),
    ("relative_humidity", by_ladybug.relative_humidity, 8),
    ("wind_speed", by_ladybug.wind_speed, 21),
):
    value = float(hour_12[place])
    in_pvlib = day.index[(day[name] - value).abs().argmin()].hour
    in_ladybug = hour_of(column, value)
    print(f"{name} of hour 12: at {in_ladybug}:00 in ladybug, at {in_pvlib}:00 in pvlib")
    assert in_pvlib == 11
    assert in_ladybug == (11 if name == "ghi" else 12)
PY
