#!/usr/bin/env bash
# EMHASS's COP of a heat pump rises to 8 as the lift goes to nought, and is 1 at nought; of a lost forecast it is 1, unsaid.
#
# Versions: emhass 0.18.7
# A good guess: the COP by Carnot's share is held at its highest bound where water is hardly warmer than outdoors, or colder; a
# forecast that is NaN stays NaN, or is refused
# Seen: `calculate_cop_heatpump` and `cop_from_tank_temperature` give 8 for a lift of a tenth of a kelvin and 1 from no lift on,
# with a warning in the log; an outdoor temperature that is NaN is a COP of 1 in both, without one
# Why it matters: a pool or a mild tank on a warm afternoon looks eight times as dear as an hour before, and so does each hour
# whose weather is missing: a plan moves heat out of its cheapest hours
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile "emhass==0.18.7" pandas==2.3.3 numpy==2.2.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from emhass.utils import calculate_cop_heatpump, cop_from_tank_temperature

outdoor_C = np.array([20.0, 25.0, 27.9, 28.0, 30.0])
flow = calculate_cop_heatpump(28.0, 0.4, outdoor_C)
tank = cop_from_tank_temperature(np.full(5, 28.0), 0.4, outdoor_C, approach=0.0)
print("outdoors, degC:     ", outdoor_C.tolist())
print("COP by the flow:    ", flow.round(2).tolist())
print("COP by the tank:    ", tank.round(2).tolist())
assert flow.round(2).tolist() == tank.round(2).tolist() == [8.0, 8.0, 8.0, 1.0, 1.0]

lost_C = np.array([5.0, np.nan])
by_flow, by_tank = calculate_cop_heatpump(35.0, 0.4, lost_C), cop_from_tank_temperature(np.full(2, 35.0), 0.4, lost_C)
print("COP at 5 degC and at a lost reading, by the flow:", by_flow.round(2).tolist(), "by the tank:", by_tank.round(2).tolist())
assert by_flow[1] == 1.0 and by_tank[1] == 1.0 and min(by_flow[0], by_tank[0]) > 3.0
EOF
