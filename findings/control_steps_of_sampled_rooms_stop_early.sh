#!/usr/bin/env bash
# python-control shows a third of a room's step response after it was sampled, and has no settling time of it.
#
# Versions: control 0.10.2, scipy 1.17.1, numpy 2.4.6
# A good guess: step_response without a time vector goes on until a room of two capacities is settled, in continuous time as sampled
# every quarter hour, and its last value is near the steady gain
# Seen: the continuous room is followed for hundreds of hours, to 99 % of its gain; the sampled one for a few, to about a third of it;
# step_info of the sampled one fails, since its own response never reaches 90 %
# Why it matters: a gain or settling time read off the response of a sampled (identified) model is several times too small
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile control==0.10.2 scipy==1.17.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import control
import numpy as np

C_AIR, C_MASS, R_INNER, R_OUTER = 1e6, 1e8, 2e-3, 5e-3  # J/K and K/W
A = [[-1 / (C_AIR * R_INNER), 1 / (C_AIR * R_INNER)], [1 / (C_MASS * R_INNER), -1 / (C_MASS * R_INNER) - 1 / (C_MASS * R_OUTER)]]
room = control.ss(A, [[1 / C_AIR], [0.0]], [[1.0, 0.0]], 0.0)
sampled = control.sample_system(room, 900.0)
shares = {}
for name, system in (("continuous", room), ("sampled", sampled)):
    response = control.step_response(system)
    shares[name] = float(response.outputs[-1] / system.dcgain())
    print(f"{name}: followed for {response.time[-1] / 3600:.1f} h, to {shares[name]:.0%} of the gain {system.dcgain():.4f} K/W")
assert np.isclose(room.dcgain(), sampled.dcgain())
try:
    control.step_info(sampled)
except IndexError as error:
    print(f"step_info of the sampled room: IndexError, {error}")
else:
    raise AssertionError("step_info of the sampled room answers")
settling_h = control.step_info(room)["SettlingTime"] / 3600
print(f"step_info of the continuous room: settled after {settling_h:.0f} h")
assert shares["continuous"] > 0.98 and shares["sampled"] < 0.4
PY
