#!/usr/bin/env bash
# numba's mean of a year of float32 readings, one a second and all about 21.5 °C, is 17.0 °C, with a standard deviation of 4.5 K.
#
# Versions: numba 0.68.1, numexpr 2.14.2, NumPy 2.4.6
# A good guess: compiled np.mean, np.sum and np.std give what NumPy gives, to the last digits of float32
# Seen: numbers are added one by one in float32, where a sum of 2^29 K is a multiple of 64: readings are rounded as they are
# added, and lost in the end. After 30 days the mean is 21.04 °C, after a year 17.02; energy stops at 4.194 MWh, 2^22 Wh, however
# long it is counted. numexpr's sum is the same; NumPy adds in halves (pairwise) and is right
# Why it matters: float32 is what loggers, Parquet files and networks hold; a week in the test agrees in four digits
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile numba==0.68.1 numpy==2.4.6 numexpr==2.14.2
"$work/venv/bin/python" - <<'EOF'
import numba
import numexpr
import numpy as np

DAY = 86400
room_C = (21.5 + 0.01 * np.random.default_rng(0).normal(size=365 * DAY)).astype(np.float32)


@numba.njit
def mean(x):
    return np.mean(x)


@numba.njit
def sd(x):
    return np.std(x)


@numba.njit
def total(x):
    return np.sum(x)


for days in (1, 7, 30, 365):
    x = room_C[: days * DAY]
    print(f"{days:3} days: NumPy {np.mean(x):.3f} ± {np.std(x):.3f} °C, numba {mean(x):.3f} ± {sd(x):.3f} °C")
assert abs(np.mean(room_C) - 21.5) < 1e-3 and mean(room_C) < 17.1 and sd(room_C) > 4.4
assert abs(float(numexpr.evaluate("sum(room_C)")) / room_C.size - mean(room_C)) < 1e-3
energy_Wh = np.full(365 * DAY, 500.0 / 3600.0, dtype=np.float32)
print(f"500 W for a year: NumPy {np.sum(energy_Wh) / 1e6:.3f} MWh, numba {total(energy_Wh) / 1e6:.3f} MWh")
assert total(energy_Wh) == 2**22 and abs(np.sum(energy_Wh) / 4.38e6 - 1.0) < 1e-3
EOF
