#!/usr/bin/env bash
# arrow's ranges and spans of hours leave one hour out where summer time ends.
#
# Versions: arrow 1.4.0
# A good guess: spans of an hour follow one another, so that a day of 25 hours has 25 of them
# Seen: 25 October 2026 in Berlin has 24, by range() and by span_range(); the hour from 02:00 to 03:00 of winter time is in none,
# between 02:59:59.999999+02:00 and 03:00+01:00; in quarters of an hour four are lost; in UTC there are 25, and March is right
# Why it matters: meters are summed, prices billed and readings averaged over such spans; what was used in that hour is nowhere,
# without an error, and a list of 24 hours is laid beside the market's 25 prices
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile arrow==1.4.0 python-dateutil==2.9.0.post0 tzdata==2026.3
"$work/venv/bin/python" - <<'PY'
from datetime import timedelta

import arrow

begin = arrow.get("2026-10-25T00:00", tzinfo="Europe/Berlin")
last = arrow.get("2026-10-25T23:59", tzinfo="Europe/Berlin")
length = arrow.get("2026-10-26T00:00", tzinfo="Europe/Berlin").to("UTC") - begin.to("UTC")
hours = list(arrow.Arrow.range("hour", begin, last))
spans = list(arrow.Arrow.span_range("hour", begin, last))
quarters = list(arrow.Arrow.interval("minute", begin, last, 15))
in_utc = list(arrow.Arrow.span_range("hour", begin.to("UTC"), last.to("UTC")))
gaps = [(a[1], b[0]) for a, b in zip(spans, spans[1:]) if b[0].to("UTC") - a[1].to("UTC") > timedelta(seconds=1)]
print("the day has", length, "| hours:", len(hours), "spans:", len(spans), "quarters:", len(quarters), "spans in UTC:", len(in_utc))
print("between spans:", [(str(a), str(b), str(b.to("UTC") - a.to("UTC"))) for a, b in gaps])
assert length == timedelta(hours=25) and len(in_utc) == 25
assert (len(hours), len(spans), len(quarters), len(gaps)) == (24, 24, 96, 1)
march = arrow.get("2026-03-29T00:00", tzinfo="Europe/Berlin")
assert len(list(arrow.Arrow.span_range("hour", march, arrow.get("2026-03-29T23:59", tzinfo="Europe/Berlin")))) == 23
PY
