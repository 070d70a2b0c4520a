#!/usr/bin/env bash
# workalendar keeps the Danish holiday that was abolished in 2024, and knows neither the Irish of 2023 nor the Polish of 2025.
#
# Versions: workalendar 17.0.0, holidays 0.109
# A good guess: two kept packages agree about which weekdays of 2027 are public holidays of a whole country
# Seen: workalendar has Store Bededag (Friday, 23 April 2027; abolished from 2024 on), not St Brigid's (Monday, 1 February;
# since 2023), not Christmas Eve in Poland (Friday; since 2025), and moves the Irish Christmas of a weekend to Monday and
# Tuesday. It counts Danish and Swedish eves, which are no public holidays. For BE, DE, FR, AT, NO, FI and ES both agree
# Why it matters: set-points, hot water and tariffs of "Sundays and public holidays" follow such a list: a school is heated
# on the days on which nobody comes, and is cold on one on which everybody does
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile workalendar==17.0.0 holidays==0.109 tzdata
"$work/venv/bin/python" -W ignore - <<'PY'
import holidays
from workalendar import europe

COUNTRIES = {
    "BE": europe.Belgium, "DE": europe.Germany, "FR": europe.France, "AT": europe.Austria, "NO": europe.Norway,
    "FI": europe.Finland, "ES": europe.Spain, "DK": europe.Denmark, "IE": europe.Ireland, "PL": europe.Poland,
    "SE": europe.Sweden,
}


def differ(code):
    """Weekdays of 2027 that are holidays for workalendar alone, and for holidays alone."""
    first = {str(day) for day, _ in COUNTRIES[code]().holidays(2027) if day.weekday() < 5}
    second = {str(day) for day in holidays.country_holidays(code, years=2027) if day.weekday() < 5}
    return sorted(first - second), sorted(second - first)


for code in COUNTRIES:
    print(code, *differ(code))
for code in ("BE", "DE", "FR", "AT", "NO", "FI", "ES"):
    assert differ(code) == ([], []), code
assert "2027-04-23" in differ("DK")[0]
assert differ("IE")[1] == ["2027-02-01"]
assert differ("PL")[1] == ["2027-12-24"]
assert differ("SE")[0] == ["2027-06-25", "2027-12-24", "2027-12-31"]
PY
