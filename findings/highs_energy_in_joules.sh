#!/usr/bin/env bash
# HiGHS calls a plan optimal that is 29 % dearer when energy is counted in joules instead of kWh.
#
# Versions: highspy 1.15.1
# A good guess: an LP of four variables has the same optimum in any unit; the solver scales what it is given
# Seen: prices per joule are below 1e-7, the absolute tolerance of reduced costs, so any plan that heats enough is
# "Optimal", gap 0: 2.04 in place of 1.58; the same happens beside one large weight when the largest is scaled to 1
# Why it matters: a controller ignores the tariff, and its status is a success: scale the objective until its least
# number is about 1, and check the cost by the multipliers
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile highspy==1.15.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import highspy
import numpy as np

PRICE = np.array([0.40, 0.10, 0.35, 0.12])  # per kWh, of four hours; 10 kWh are needed, at most 4 in an hour


def cost(joules_per_unit):
    """What HiGHS' optimum costs, by its status, where energy is counted in units of so many joules."""
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    per_unit = joules_per_unit / 3.6e6
    for price in PRICE:
        solver.addVariable(0.0, 4.0 / per_unit, price * per_unit)
    solver.addRow(10.0 / per_unit, highspy.kHighsInf, 4, np.arange(4, dtype=np.int32), np.ones(4))
    solver.run()
    status = solver.modelStatusToString(solver.getModelStatus())
    kWh = np.array(solver.getSolution().col_value) * per_unit
    print(f"{joules_per_unit:9g} J a unit: {status}, {np.round(kWh, 3)} kWh, {PRICE @ kWh:.3f}")
    return status, PRICE @ kWh


status, by_kWh = cost(3.6e6)
assert status == "Optimal" and abs(by_kWh - 1.58) < 1e-6
status, by_J = cost(1.0)
assert status == "Optimal" and by_J > 1.25 * by_kWh
EOF
