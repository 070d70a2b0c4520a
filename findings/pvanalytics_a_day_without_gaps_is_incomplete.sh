#!/usr/bin/env bash
# pvanalytics: the whole day of 23 hours is 95.8 % complete, and the day of 25 hours is complete though an hour of it is lost.
#
# Versions: pvanalytics 0.2.2, pandas 2.3.3
# A good guess: of an index in local time each day is measured by its own length: a day without a gap scores 1, whatever its hours, and one
# that lost an hour scores less
# Seen: seconds of data are divided by 86,400. The last Sunday of March scores 23/24 and is dropped by `complete` at 99 %; that of October
# scores 25/24, and 1 with an hour lost, so that `complete` keeps it
# Why it matters: filters of days for degree days, baselines and performance drop a good day each spring and keep a broken one each autumn
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pvanalytics==0.2.2 pandas==2.3.3 numpy==2.4.6 pvlib==0.16.1 scipy==1.17.1  tzdata==2025.2
"$work/venv/bin/python" -W ignore - <<'EOF'
import pandas as pd
from pvanalytics.quality.gaps import complete, completeness_score


def score(day, lost=()):
    begin = pd.Timestamp(day, tz="Europe/Brussels")
    stamps = pd.date_range(begin, begin + pd.DateOffset(days=1), freq="15min", inclusive="left")
    power = pd.Series(1.0, stamps)
    power.iloc[list(lost)] = float("nan")
    share = completeness_score(power, freq="15min", keep_index=False)
    assert len(share) == 1
    kept = bool(complete(power, minimum_completeness=0.99, freq="15min").all())
    print(f"{day}: {len(power) / 4:g} h, {len(lost) / 4:g} h lost, score {share.iloc[0]:.3f}, {'kept' if kept else 'dropped'} at 99 %")
    return round(float(share.iloc[0]), 6), kept


assert score("2026-02-01") == (1.0, True)
assert score("2026-02-01", range(40, 44)) == (round(23 / 24, 6), False)
assert score("2026-03-29") == (round(23 / 24, 6), False)
assert score("2026-10-25") == (round(25 / 24, 6), True)
assert score("2026-10-25", range(40, 44)) == (1.0, True)
EOF
