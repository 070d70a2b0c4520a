#!/usr/bin/env bash
# entsoe-py counts the first price of the next day to a day, and takes the first quarter hour as the price of an hour.
#
# Versions: entsoe-py 0.8.1, pandas 3.0.6
# A good guess: `query_day_ahead_prices(zone, start, end)` from midnight to midnight gives the 100 quarter hours of the day on
# which clocks go back (96 and 24 otherwise), since `end` ends the day; prices of quarter hours are given as they are or as means
# Seen: `end` belongs to it: 101 values, the last of which is the next day's first price, where that day is published; of
# quarter hours before 1 October 2025 every hour has the price of its first quarter. Positions that curve type A03 leaves out,
# also at the end of a day, are filled as the guide says
# Why it matters: days that are put one after the other hold a price twice, a mean of a day is off, and a file written before
# the next day was published differs from one written after
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile entsoe-py==0.8.1 pandas==3.0.6
# The answers are of the documented layout and stand here: nothing is asked of the service.
"$work/venv/bin/python" -W ignore - <<'EOF'
from types import SimpleNamespace

import pandas as pd
from entsoe import EntsoePandasClient

ZONE = "Europe/Brussels"


def day(begin, prices):
    end = begin + pd.DateOffset(days=1)
    bounds = [moment.tz_convert("UTC").strftime("%Y-%m-%dT%H:%MZ") for moment in (begin, end)]
    points = "".join(
        f"<Point><position>{k + 1}</position><price.amount>{price}</price.amount></Point>" for k, price in enumerate(prices)
    )
    return (
        f"<TimeSeries><curveType>A03</curveType><Period><timeInterval><start>{bounds[0]}</start><end>{bounds[1]}</end>"
        f"</timeInterval><resolution>PT15M</resolution>{points}</Period></TimeSeries>"
    )


def asked(begin, document):
    client = EntsoePandasClient(api_key="none")
    text = f"<Publication_MarketDocument>{document}</Publication_MarketDocument>"
    client._base_request = lambda params, start, end: SimpleNamespace(text=text)
    return client.query_day_ahead_prices("BE", start=begin, end=begin + pd.DateOffset(days=1))


sunday, monday = (pd.Timestamp(f"2025-10-{number}", tz=ZONE) for number in (26, 27))
both = asked(sunday, day(sunday, range(90)) + day(monday, range(1000, 1096)))
alone = asked(sunday, day(sunday, range(90)))
before = asked(pd.Timestamp("2025-09-20", tz=ZONE), day(pd.Timestamp("2025-09-20", tz=ZONE), range(96)))
print(f"day of 25 hours: {len(alone)} values alone, {len(both)} with the next day published, last {both.iloc[-1]}")
print(f"quarter hours of September: {len(before)} values, {before.iloc[:3].tolist()}")
assert len(alone) == 100 and alone.iloc[-1] == 89 and len(both) == 101 and both.iloc[-1] == 1000
assert before.iloc[:3].tolist() == [0, 4, 8]
EOF
