#!/usr/bin/env bash
# python-control's first-order hold gives right outputs with states that are no longer those of the model.
#
# Versions: control 0.10.2, SciPy 1.17.1
# A good guess: sampled states are the continuous ones at the sampling times, as with a zero-order hold, so that a measured
# room temperature is the initial state
# Seen: under a constant input of 1 the state x of dx/dt = u - x is 0.632 after one time constant; the sampled state is 0.400
# (a part of the input has moved into the state), and D is 0.368 where the model has none
# Why it matters: an observer or controller that starts such a model from measured temperatures is off by a share of the input
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile control==0.10.2 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import control
import numpy as np

room = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
true = 1 - np.exp(-1.0)
states = {}
for method in ("zoh", "foh"):
    sampled = control.sample_system(room, 1.0, method=method)
    states[method] = float(control.forced_response(sampled, np.arange(3.0), np.ones(3)).states[0, 1])
print("state after one time constant: true", round(true, 3), {name: round(x, 3) for name, x in states.items()})
assert abs(states["zoh"] - true) < 1e-9 and abs(states["foh"] - true) > 0.2
EOF
