#!/usr/bin/env bash
# OpenLEADR reads the duration of a week as no time at all, and a time with an offset as text.
#
# Versions: openleadr 0.5.36
# A good guess: "P1W" is seven days (the library itself says what it makes of P1M: 30 days, with a warning), and
# "2026-01-15T06:00:00+01:00" is that instant, or both are refused
# Seen: P1W is 0:00:00, without a word; the time with an offset comes back as the text it was, with a line in the log
# Why it matters: OpenADR's events of utilities (do not draw power, or the price changes, for so long from then) that last a
# week end as they begin; and the comparison of their start with a clock raises in someone else's code
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile openleadr==0.5.36
"$work/venv/bin/python" -W ignore - <<'EOF'
import logging
from datetime import datetime, timedelta

from openleadr.utils import parse_datetime, parse_duration

logging.disable(logging.CRITICAL)
for text, seen in (("PT15M", timedelta(minutes=15)), ("P7D", timedelta(days=7)), ("P1W", timedelta(0)), ("P1M", timedelta(days=30))):
    found = parse_duration(text)
    print(f"{text}: {found}")
    assert found == seen
assert isinstance(parse_datetime("2026-01-15T05:00:00Z"), datetime)
found = parse_datetime("2026-01-15T06:00:00+01:00")
print(f"a time with an offset: {found!r}")
assert found == "2026-01-15T06:00:00+01:00"
EOF
