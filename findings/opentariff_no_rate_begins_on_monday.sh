#!/usr/bin/env bash
# opentariff refuses a rate from Monday to Friday, since its Monday is 0, and dynamic prices of nought, below it, and of 100 or more.
#
# Versions: opentariff 1.2.0, pydantic 2.14.4
# A good guess: a schema of British tariffs takes "weekdays" as it takes Tuesday to Friday, and each price that half-hourly tariffs had:
# nought and below it on windy nights, 100 p/kWh in their own cap
# Seen: DayOfWeek.MONDAY is 0, and whether both ends of a pair are given is asked by their truth: Monday to Friday, and Saturday to Monday,
# "require that each of the elements of the pairs … appear together". unit_rate must lie between 0 and 100, both left out, for dynamic
# rates too
# Why it matters: the most usual window cannot be written, so that weekday rates are given from Tuesday on, or without days; and a day
# with one price of nought, at which a heat pump should run, is refused whole
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile opentariff==1.2.0 pydantic==2.14.4
"$work/venv/bin/python" - <<'EOF'
from datetime import datetime, timezone

from opentariff.Enums.base_enums import DayOfWeek
from opentariff.models.tariff_models import Rate
from pydantic import ValidationError

DAYS = {"rate_type": "time_of_use_static", "unit_rate": "28.5"}
HALF_HOUR = [datetime(2026, 5, 1, 2, minute, tzinfo=timezone.utc) for minute in (0, 30)]
DYNAMIC = {"rate_type": "time_of_use_dynamic", "datetime_from": HALF_HOUR[0], "datetime_to": HALF_HOUR[1]}


def taken(**given):
    try:
        Rate(fuel="electricity", **given)
    except ValidationError as error:
        print("refused:", error.errors()[0]["msg"][:150])
        return False
    return True


day = DayOfWeek
assert taken(day_from=day.TUESDAY, day_to=day.FRIDAY, **DAYS) and taken(day_from=day.SATURDAY, day_to=day.SUNDAY, **DAYS)
assert not taken(day_from=day.MONDAY, day_to=day.FRIDAY, **DAYS)
assert not taken(day_from=day.SATURDAY, day_to=day.MONDAY, **DAYS)
assert [taken(unit_rate=price, **DYNAMIC) for price in ("0.01", "99.9", "0", "-3.2", "100")] == [True, True, False, False, False]
EOF
