#!/usr/bin/env bash
# electric-emission-cost: a monthly peak charge is paid once for two months, and a charge for nights or winters is never paid.
#
# Versions: electric-emission-cost 0.0.5; pandas 2.3.3, pyomo 6.9.2
# A good guess: with `assessed` monthly, 10 a kW and peaks of 50 kW in January and 100 kW in February cost 1500; a charge from
# month 11 to 3 holds in January, one from hour 22 to 6 at 23:00
# Seen: 1000, for there is one peak however long the bill is; months and hours whose end comes before their beginning hold never, so that
# a winter's charge, or that of the night, is 0 without a word
# Why it matters: who plans or judges a building's flexibility by such a bill sees a peak of January as free, and full load in the hours
# that a tariff charges most
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile electric-emission-cost==0.0.5 pandas==2.3.3 pyomo==6.9.2 pytz==2025.2
"$work/venv/bin/python" -W ignore - <<'PY'
import datetime

import numpy as np
import pandas as pd
from electric_emission_cost import costs

CHARGE = {
    "utility": "electric", "type": "demand", "name": "all", "period": "all", "assessed": "monthly",
    "month_start": 1, "month_end": 12, "weekday_start": 0, "weekday_end": 6, "hour_start": 0, "hour_end": 24,
    "basic_charge_limit (metric)": 0, "charge (metric)": 10.0,
}
POWER_KW = np.r_[np.full(31 * 96, 50.0), np.full(28 * 96, 100.0)]


def cost(power_kW, start, end, **changes):
    charges = costs.get_charge_dict(start, end, pd.DataFrame([CHARGE | changes]))
    kind = {"desired_utility": "electric", "desired_charge_type": changes.get("type", "demand")}
    return float(costs.calculate_cost(charges, {"electric": power_kW}, resolution="15m", **kind)[0])


january, february, march = (datetime.datetime(2026, month, 1) for month in (1, 2, 3))
each = [cost(POWER_KW[: 31 * 96], january, february), cost(POWER_KW[31 * 96 :], february, march)]
both = cost(POWER_KW, january, march)
print(f"peak charge of January, of February: {each}; of both in one bill: {both}")
assert each == [500, 1000] and both == 1000
energy = {"type": "energy", "charge (metric)": 0.2}
always = cost(POWER_KW, january, march, **energy)
winter = cost(POWER_KW, january, march, **energy, month_start=11, month_end=3)
night = cost(POWER_KW, january, march, **energy, hour_start=22, hour_end=6)
print(f"energy at 0.2 always {always:.0f}, from November to March {winter}, from 22 to 6 o'clock {night}")
assert always > 20000 and winter == 0 and night == 0
PY
