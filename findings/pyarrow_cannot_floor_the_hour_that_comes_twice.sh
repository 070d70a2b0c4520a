#!/usr/bin/env bash
# Arrow cannot round down a table that holds the hour in which clocks are set back.
#
# Versions: pyarrow 26.0.1
# A good guess: stamps with a zone are instants; floor_temporal to 15 minutes (which every zone's clock shares) leaves whole
# quarter hours as they are
# Seen: ArrowInvalid, "Local time is ambiguous", for the whole array, by minutes and by one hour; ceil and round the same.
# In UTC it works, and so do 6 hours and a day in the zone, whose edges are not ambiguous; no option says which of both
# hours is meant
# Why it matters: a year's table of readings is refused for one hour; a live loop that rounds its last day stops once a year
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pyarrow==26.0.1 tzdata
"$work/venv/bin/python" -W ignore - <<'PY'
from datetime import datetime, timedelta, timezone

import pyarrow as pa
import pyarrow.compute as pc

first = datetime(2025, 10, 25, 22, tzinfo=timezone.utc)
stamps = [first + timedelta(minutes=15 * k) for k in range(100)]
local = pa.array(stamps, pa.timestamp("us", "Europe/Brussels"))
utc = pa.array(stamps, pa.timestamp("us", "UTC"))
assert pc.floor_temporal(utc, 15, "minute").to_pylist() == utc.to_pylist()
for rounded in (pc.floor_temporal, pc.ceil_temporal, pc.round_temporal):
    for multiple, unit in ((15, "minute"), (1, "hour")):
        try:
            rounded(local, multiple, unit)
        except pa.ArrowInvalid as error:
            print(rounded.__name__, multiple, unit, "->", str(error).splitlines()[0])
        else:
            raise SystemExit(f"{rounded.__name__} rounds the hour that comes twice now")
assert len(set(pc.floor_temporal(local, 6, "hour").to_pylist())) == 4
PY
