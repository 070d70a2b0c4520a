#!/usr/bin/env bash
# One reading that is NaN, and PID controllers of simple-pid and advanced-pid give NaN for ever, limits or not.
#
# Versions: simple-pid 2.0.1, advanced-pid 0.0.8
# A good guess: a missing reading raises, or counts for its step: the output keeps within its limits (0 to 1), and with the next good
# reading all is as before
# Seen: both add the error to their integral, which is NaN from then on, and both clip by asking whether a value is above or below, which
# NaN never is: each later output is NaN. simple-pid says no word; only reset(), or manual mode and back, mends it
# Why it matters: a valve whose sensor was away for a minute gets no number until somebody starts the controller again, and a driver that
# turns NaN into an integer opens or closes it
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile simple-pid==2.0.1 advanced-pid==0.0.8
"$work/venv/bin/python" - <<'EOF'
from math import isnan

import advanced_pid
import simple_pid

READINGS = (20.0, 20.5, float("nan"), *[20.5] * 200)

simple = simple_pid.PID(0.1, 0.01, 0.0, setpoint=21.0, output_limits=(0.0, 1.0), sample_time=None)
advanced = advanced_pid.PID(0.1, 0.01, 0.0, 0.0)
advanced.set_output_limits(0.0, 1.0)
outputs = {
    "simple-pid": [simple(T, dt=60.0) for T in READINGS],
    "advanced-pid": [advanced.integrate(60.0 * i, 21.0 - T) for i, T in enumerate(READINGS)],
}
for name, output in outputs.items():
    lost = sum(isnan(one) for one in output)
    print(f"{name}: {output[0]:.2f}, {output[1]:.2f}, then NaN {lost} times in {len(output)}")
    assert not any(isnan(one) for one in output[:2]) and lost == len(output) - 2
simple.reset()
assert 0.0 <= simple(20.5, dt=60.0) <= 1.0
EOF
