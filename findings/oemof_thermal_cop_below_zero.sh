#!/usr/bin/env bash
# oemof.thermal gives a heat pump a COP of −25 where the source is warmer than the sink, and of a thousand just before.
#
# Versions: oemof.thermal 0.0.8
# A good guess: `calc_cops` refuses a source at or above the sink, or limits the COP
# Seen: 40 °C from 39.9 °C has a COP of 1253, from 45 °C one of −25; only exactly equal temperatures raise (a division by zero)
# Why it matters: floor heating at 25 °C beside air of 26 °C in spring, or a source warmed by a process: an energy system model
# then earns electricity by heating, and the optimum is to heat as much as it may
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile oemof.thermal==0.0.8
"$work/venv/bin/python" -W ignore - <<'EOF'
from oemof.thermal.compression_heatpumps_and_chillers import calc_cops

seen = {}
for source in (12.0, 39.9, 45.0):
    seen[source] = calc_cops(mode="heat_pump", temp_high=[40.0], temp_low=[source], quality_grade=0.4)[0]
    print(f"40 degC from {source} degC: COP {seen[source]:.1f}")
assert 4.0 < seen[12.0] < 5.0 and seen[39.9] > 1000.0 and seen[45.0] < -20.0
EOF
