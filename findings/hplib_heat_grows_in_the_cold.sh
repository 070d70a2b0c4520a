#!/usr/bin/env bash
# hplib's generic controlled air heat pump of 10 kW gives 7 kW of heat at 7 °C outdoors and 16 kW at -7 °C.
#
# Versions: hplib 1.9 (its database of the release)
# A good guess: heat that an air machine can give falls with the outdoor temperature (a tenth to a third over 14 K), and is
# 10 kW at the point that was named
# Seen: at 35 °C of flow `simulate` gives twice as much heat at -7 °C as at 7 °C; the laws are fitted to points of EN 14825
# (part load along a heating curve), not to full load. Below a COP of 1 it returns COP 1 and a constant heat
# Why it matters: as "capacity" in a plan this machine never runs short on the coldest night, when the real one does
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile "hplib==1.9" pandas==3.0.5 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from hplib import hplib

machine = hplib.HeatPump(hplib.get_parameters("Generic", group_id=1, t_in=-7, t_out=52, p_th=10000))


def at(outdoor_C, flow_C=35):
    result = machine.simulate(outdoor_C, flow_C - 5, outdoor_C, mode=1)
    return [float(np.ravel(result[key])[0]) for key in ("P_th", "COP")]


heat = {outdoor: at(outdoor)[0] for outdoor in (-15, -7, 0, 7, 12)}
print("heat at a flow of 35 degC, kW:", {outdoor: round(value / 1000, 1) for outdoor, value in heat.items()})
assert heat[-7] > 2 * heat[7] and heat[0] > 1.4 * heat[7]
cold = [at(-25, flow) for flow in (45, 55, 65)]
print("at -25 degC and flows of 45, 55, 65 degC:", [(round(q / 1000, 1), cop) for q, cop in cold])
assert len({round(q) for q, _ in cold}) == 1 and all(cop == 1 for _, cop in cold)
EOF
