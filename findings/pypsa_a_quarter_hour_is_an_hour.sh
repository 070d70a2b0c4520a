#!/usr/bin/env bash
# PyPSA takes every snapshot as an hour, whatever its index of time says: a 1 kWh tank is filled by 1 kW in a quarter hour.
#
# Versions: pypsa 1.2.4, highspy 1.15.1
# A good guess: snapshots that are a DatetimeIndex of quarter hours have weightings of 0.25 h; the tank takes four of them
# Seen: all weightings are 1.0; the plan charges 1 kW in one snapshot and the tank is full, no warning; with
# `weightings_from_timedelta=True` it takes four, at the same cost
# Why it matters: heat stores and batteries look four times as quick beside quarter-hour prices, and energy costs are four
# times too high wherever a load is given in kW
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pypsa==1.2.4 highspy==1.15.1 pandas==3.0.5 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import logging

import pandas as pd
import pypsa

logging.disable(logging.CRITICAL)
quarters = pd.date_range("2026-01-01", periods=8, freq="15min")


def snapshots_of_charging(**options):
    network = pypsa.Network()
    network.set_snapshots(quarters, **options)
    network.add("Bus", "house")
    network.add("Generator", "grid", bus="house", p_nom=1.0, marginal_cost=1.0)
    full = pd.Series([0.0] * 3 + [1.0] + [0.0] * 4, index=quarters)
    network.add("Store", "tank", bus="house", e_nom=1.0, e_initial=0.0, e_min_pu=full)
    network.optimize(solver_name="highs", log_to_console=False)
    charging = network.stores_t.p["tank"] < -1e-6
    return int(charging.sum()), float(network.snapshot_weightings.stores.iloc[0])


plain, told = snapshots_of_charging(), snapshots_of_charging(weightings_from_timedelta=True)
print(f"snapshots of charging and their weight: by default {plain}, told to look at the index {told}")
assert plain == (1, 1.0) and told == (4, 0.25)
EOF
