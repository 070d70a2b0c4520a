#!/usr/bin/env bash
# How long is 01:15? 75 minutes for pydantic, 75 seconds for pytimeparse, nothing for durations; pandas takes "15" for 15 ns.
#
# Versions: pydantic 2.14.4, pytimeparse 1.1.10, durations 0.3.3, humanfriendly 10.0, pandas 3.0.5
# A good guess: an hour and a quarter for those that take it, an error from the others
# Seen: 4500 s, 75 s and 0.0 s; durations gives 0.0 for "15" and "01:15", and 3600 s for "1h30", without an error; humanfriendly
# takes "15" for seconds and refuses "01:15"; pandas refuses "01:15" and takes "15" for nanoseconds
# Why it matters: a least run time or a step of 00:15 in a settings file is a quarter of an hour or of a minute, or none, by the
# library that reads it
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pydantic==2.14.4 pytimeparse==1.1.10 durations==0.3.3 humanfriendly==10.0 pandas==3.0.5
"$work/venv/bin/python" -W ignore - <<'EOF'
from datetime import timedelta

import humanfriendly
import pandas as pd
import pytimeparse
from durations import Duration
from pydantic import TypeAdapter

READERS = {
    "pydantic": lambda text: TypeAdapter(timedelta).validate_python(text).total_seconds(),
    "pytimeparse": pytimeparse.parse,
    "durations": lambda text: Duration(text).to_seconds(),
    "humanfriendly": humanfriendly.parse_timespan,
    "pandas": lambda text: pd.Timedelta(text).total_seconds(),
}


def read(reader, text):
    """Seconds, or None where it is refused."""
    try:
        return reader(text)
    except (ValueError, humanfriendly.InvalidTimespan):
        return None


found = {text: {name: read(reader, text) for name, reader in READERS.items()} for text in ("01:15", "15", "1h30")}
for text, seconds in found.items():
    print(f"{text:6}", seconds)
assert list(found["01:15"].values()) == [4500.0, 75, 0.0, None, None]
assert list(found["15"].values()) == [None, None, 0.0, 15.0, 0.0] and pd.Timedelta("15").value == 15
assert found["1h30"]["durations"] == 3600.0
EOF
