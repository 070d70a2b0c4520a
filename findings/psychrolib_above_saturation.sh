#!/usr/bin/env bash
# PsychroLib returns a relative humidity of 1.99 and clips the dew point of the same air, without an error.
#
# Versions: psychrolib 2.5.0
# A good guess: a humidity ratio that air of 20 degC cannot hold is refused, as a relative humidity of 50 (meant as
# percent) is
# Seen: GetRelHumFromHumRatio(20, 0.03, 101325) is 1.994; dew point and wet bulb of that state are 20.0, the air's own
# temperature
# Why it matters: a broken humidity sensor, or a ratio of one hour with the temperature of another, passes; outputs are
# to be checked for 0 to 1
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile psychrolib==2.5.0
"$work/venv/bin/python" -W ignore - <<'EOF'
import psychrolib

psychrolib.SetUnitSystem(psychrolib.SI)
humidity = psychrolib.GetRelHumFromHumRatio(20.0, 0.03, 101325.0)
dew = psychrolib.GetTDewPointFromHumRatio(20.0, 0.03, 101325.0)
print("relative humidity", humidity, "dew point", dew)
assert 1.9 < humidity < 2.1 and abs(dew - 20.0) < 1e-6
try:
    psychrolib.GetHumRatioFromRelHum(20.0, 50.0, 101325.0)
except ValueError as error:
    print("as percent:", error)
else:
    raise SystemExit("50 was taken")
EOF
