#!/usr/bin/env bash
# xknx sends a local time in July as KNX date and time without summer time, and drops that flag when it reads one.
#
# Versions: xknx 4.0.0, Python's zoneinfo
# A good guess: a datetime that knows its zone goes out with the standard's flag SUTI (summer time) as its zone says, and one that comes with
# the flag can be told apart in the hour that comes twice
# Seen: `KNXDateTime.from_datetime` leaves the flag at 0 at any date, so 02:30 before and after the clocks go back are the same eight
# octets; `as_datetime` gives both as the same datetime without zone, though the telegrams differ in the flag
# Why it matters: a clock or logger on the bus that goes by the flag is an hour wrong all summer, and schedules and records of the repeated
# hour are of either one
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile xknx==4.0.0 tzdata==2025.2
"$work/venv/bin/python" - <<'EOF'
from dataclasses import replace
from datetime import datetime
from zoneinfo import ZoneInfo

from xknx.dpt import DPTDateTime
from xknx.dpt.dpt_19 import KNXDateTime

HOME = ZoneInfo("Europe/Vienna")
SUMMER = 0b1  # of the seventh octet


def octets(told):
    return bytes(DPTDateTime.to_knx(told).value)


july = datetime(2026, 7, 1, 12, tzinfo=HOME)
first, second = (datetime(2026, 10, 25, 2, 30, tzinfo=HOME, fold=fold) for fold in (0, 1))
for at in (july, first, second):
    sent = octets(KNXDateTime.from_datetime(at))
    print(f"{at.isoformat()} (summer time {at.dst()}): {sent.hex(' ')}, flag {sent[6] & SUMMER}")
    assert sent[6] & SUMMER == 0
assert first.timestamp() != second.timestamp()
assert octets(KNXDateTime.from_datetime(first)) == octets(KNXDateTime.from_datetime(second))
come = [replace(KNXDateTime.from_datetime(second), dst=dst) for dst in (True, False)]
read = [DPTDateTime.from_knx(DPTDateTime.to_knx(one)) for one in come]
print("come with and without the flag:", *[(one.dst, one.as_datetime().isoformat()) for one in read])
assert [one.dst for one in read] == [True, False]
assert read[0].as_datetime() == read[1].as_datetime() == datetime(2026, 10, 25, 2, 30)
EOF
