#!/usr/bin/env bash
# A spread of 2 °C becomes 275.15 K in astropy and in pint's ptp, and a sum of degrees is taken by unyt.
#
# Versions: astropy 8.0.2, pint 0.25.3, unyt 3.2.0
# A good guess: standard deviation, range and difference of temperatures in degrees Celsius convert to kelvin as differences do, or
# are refused
# Seen: astropy converts all of them, the plain difference too, as temperatures. pint tells differences apart (its std and diff are
# right), but not in np.ptp. unyt refuses np.mean, np.std and np.diff of °C, but takes np.sum, and converts 63 °C to 336 K
# Why it matters: noise of a sensor or the range of a day, handed on in K, is 273 K too large: a filter trusts no reading any more
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile astropy==8.0.2 pint==0.25.3 unyt==3.2.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import astropy.units
import numpy as np
import pint
import unyt

READINGS = np.array([20.0, 22.0, 21.0])
celsius = READINGS * astropy.units.deg_C
pint_celsius = pint.UnitRegistry().Quantity(READINGS, "degC")
unyt_celsius = unyt.unyt_array(READINGS, "degC")


def by_astropy(value):
    return float(value.to_value(astropy.units.K, astropy.units.temperature()))


def is_refused(call):
    try:
        call()
    except Exception:
        return True
    return False


astropy_K = [by_astropy(np.std(celsius)), by_astropy(np.ptp(celsius)), by_astropy(celsius[1] - celsius[0])]
pint_K = [float(f(pint_celsius).to("K").magnitude) for f in (np.std, np.ptp)]
print(f"astropy: standard deviation {astropy_K[0]:.2f} K, range {astropy_K[1]:.2f} K, difference {astropy_K[2]:.2f} K")
print(f"pint: standard deviation {pint_K[0]:.2f} K, range {pint_K[1]:.2f} K")
total = unyt_celsius.sum()
print(f"unyt: sum {total}, in kelvin {total.to('K')}; mean refused: {is_refused(lambda: np.mean(unyt_celsius))}")
assert min(astropy_K) > 273 and pint_K[0] < 1 and pint_K[1] > 273
assert abs(float(total.to("K").value) - 336.15) < 1e-6
assert all(is_refused(lambda f=f: f(unyt_celsius)) for f in (np.mean, np.std, np.diff))
PY
