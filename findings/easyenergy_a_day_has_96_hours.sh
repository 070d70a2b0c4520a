#!/usr/bin/env bash
# easyenergy counts quarters as hours: a day of quarter-hour prices has 96 that are as cheap as now, and gaps have the price before.
#
# Versions: easyenergy 2.2.0
# A good guess: "hours priced equal or lower" of a day with one price is 24, in quarter hours too, as the exchange has them since October
# 2025; at a quarter whose price is missing there is none
# Seen: 96 (100 on the day when clocks go back): prices are counted, not time. A price holds for an hour or until the next one begins, so
# of three quarters that are missing each has the price of the one before, and no word is said. Hourly prices are right
# Why it matters: "heat in the cheapest six hours" is an hour and a half, and a plan over a gap pays another price than the one it shows
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile easyenergy==2.2.0
"$work/venv/bin/python" - <<'EOF'
from datetime import datetime, timedelta, timezone

from easyenergy.models import Electricity

BEGIN = datetime(2026, 3, 2, tzinfo=timezone.utc)


def day(minutes, prices):
    """A day's prices as the service gives them, in steps of so many minutes."""
    stamps = [BEGIN + timedelta(minutes=minutes * i) for i in range(len(prices))]
    rows = zip(stamps, prices, strict=True)
    told = [{"Timestamp": f"{at:%Y-%m-%dT%H:%M:%S+00:00}", "TariffUsage": p, "TariffReturn": p} for at, p in rows if p is not None]
    electricity = Electricity.from_dict(told)
    electricity.utcnow = lambda: BEGIN + timedelta(hours=12)
    return electricity


hourly, quarters = day(60, [0.25] * 24), day(15, [0.25] * 96)
print("hours as cheap as now, of hourly prices:", hourly.hours_priced_equal_or_lower_usage)
print("of quarter hours:", quarters.hours_priced_equal_or_lower_usage)
assert (hourly.hours_priced_equal_or_lower_usage, quarters.hours_priced_equal_or_lower_usage) == (24, 96)
gap = day(15, [0.10] * 40 + [None] * 3 + [0.40] * 53)
seen = [gap.price_at_time(BEGIN + timedelta(minutes=15 * i)) for i in range(38, 45)]
print("around a gap of three quarters:", *seen)
assert seen == [0.10, 0.10, 0.10, 0.10, 0.10, 0.40, 0.40]
EOF
