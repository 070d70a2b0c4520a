#!/usr/bin/env bash
# greenbutton-objects reads one block of readings of an entry: of a meter's file of three days it returns the first day.
#
# Versions: greenbutton-objects 2024.7.11
# A good guess: a Green Button file (ESPI in Atom) gives all of its readings, whether each day's IntervalBlock has an entry of its own or
# one entry has them all; both forms are in use, a gas supplier's download of 2024 has 36 monthly blocks in one entry
# Seen: of three blocks of 24 hours the first is returned: 24 readings and 12 kWh of 36 kWh, without an error or a warning. With an entry
# a block it is 72 and 36 kWh
# Why it matters: a bill, a baseline and the base load of a house are worked out from a third, or a thirty-sixth, of what the meter said
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile greenbutton-objects==2024.7.11
"$work/venv/bin/python" -W ignore - "$work/feed.xml" <<'EOF'
import sys
from pathlib import Path

from greenbutton_objects.parse import parse_feed

FILE, DAY, HOUR, FIRST = Path(sys.argv[1]), 86400, 3600, 1767225600  # 2026-01-01, UTC
POINT = "RetailCustomer/1/UsagePoint/1"


def period(name, start, seconds):
    return f"<{name}><duration>{seconds}</duration><start>{start}</start></{name}>"


def block(day):
    readings = "".join(
        f"<IntervalReading>{period('timePeriod', FIRST + DAY * day + HOUR * hour, HOUR)}<value>500</value></IntervalReading>"
        for hour in range(24)
    )
    interval = period("interval", FIRST + DAY * day, DAY)
    return f'<IntervalBlock xmlns="http://naesb.org/espi">{interval}{readings}</IntervalBlock>'


def entry(content, own, up, *related):
    links = [("self", own), ("up", up), *(("related", one) for one in related)]
    named = "".join(f'<link rel="{kind}" href="{where}"/>' for kind, where in links)
    return f"<entry>{named}<title/><content>{content}</content></entry>"


def resource(name, content=""):
    return f'<{name} xmlns="http://naesb.org/espi">{content}</{name}>'


def read(contents):
    meter = f"{POINT}/MeterReading/1"
    entries = [
        entry(
            resource("UsagePoint", "<ServiceCategory><kind>0</kind></ServiceCategory>"),
            POINT,
            "RetailCustomer/1/UsagePoint",
            f"{POINT}/MeterReading",
        ),
        entry(resource("MeterReading"), meter, f"{POINT}/MeterReading", f"{meter}/IntervalBlock", "ReadingType/1"),
        entry(
            resource("ReadingType", "<powerOfTenMultiplier>0</powerOfTenMultiplier><uom>72</uom>"),
            "ReadingType/1",
            "ReadingType",
        ),
    ]
    entries += [
        entry(content, f"{meter}/IntervalBlock/{k}", f"{meter}/IntervalBlock") for k, content in enumerate(contents)
    ]
    FILE.write_text(f'<feed xmlns="http://www.w3.org/2005/Atom">{"".join(entries)}</feed>')
    (point,) = parse_feed(str(FILE))
    (meter_reading,) = point.meterReadings
    readings = list(meter_reading.intervalReadings)
    assert {reading.value_symbol for reading in readings} == {"Wh"}
    return len(readings), sum(reading.value for reading in readings) / 1000


days = [block(day) for day in range(3)]
apart, together = read(days), read(["".join(days)])
print(f"an entry a block: {apart[0]} readings, {apart[1]:g} kWh; one entry: {together[0]} readings, {together[1]:g} kWh")
assert apart == (72, 36.0) and together == (24, 12.0)
EOF
