#!/usr/bin/env bash
# aiopvpc knows no tariff period from 22:00 on 31 December 2025 on, and calls Good Friday of 2025 cheap.
#
# Versions: aiopvpc 4.3.1, tzdata 2025.2
# A good guess: the periods of Spain's tariff 2.0TD follow from the hour, the day of the week and national holidays of a fixed date,
# for any year; Good Friday, whose date moves, is an ordinary day (the rule leaves such days out)
# Seen: holidays are a table of 2021 to 2025. A Tuesday of 2027 at 11:00 is a KeyError, so is a Sunday, and so are the last two hours
# of 2025, since the period after theirs is asked for too. Good Friday at 11:00 is P3, the cheapest
# Why it matters: who plans a heat pump or a car on these periods has none this winter; on Good Friday it runs through ten dear hours
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile aiopvpc==4.3.1 tzdata==2025.2
"$work/venv/bin/python" -W ignore - <<'PY'
from datetime import datetime
from zoneinfo import ZoneInfo

from aiopvpc.pvpc_tariff import get_current_and_next_tariff_periods


def period(*when):
    """Period of an hour on the mainland, or the name of the error."""
    try:
        return get_current_and_next_tariff_periods(datetime(*when, tzinfo=ZoneInfo("Europe/Madrid")), False)[0]
    except KeyError as error:
        return f"KeyError {error}"


SEEN = {
    (2025, 4, 15, 11): "P1",  # Tuesday
    (2025, 4, 18, 11): "P3",  # Good Friday
    (2025, 12, 25, 11): "P3",
    (2025, 12, 31, 21): "P1",
    (2025, 12, 31, 22): "KeyError 2026",
    (2027, 2, 2, 11): "KeyError 2027",  # Tuesday
    (2027, 2, 7, 11): "KeyError 2027",  # Sunday
}
for when, seen in SEEN.items():
    print(f"{datetime(*when):%a %d.%m.%Y %H:%M} {period(*when)}")
    assert period(*when) == seen
PY
