#!/usr/bin/env bash
# By its own table hplib's laws, straight in both temperatures, miss the power of most regulated heat pumps by more than 10 %.
#
# Versions: hplib 1.9 (its database of the release)
# A good guess: power and heat as straight lines in source and sink temperature, fitted machine by machine, are within 10 % of
# certified measurements, regulated or not
# Seen: median error of power 2 % for 23 on/off air machines, 17 % for 366 regulated ones, of which 76 % miss 10 %; of heat 5
# and 21 %. Certified points of regulated machines are at part load, and the law has no level in it
# Why it matters: costs of a plan by such a law are wrong where a machine modulates; a level belongs into the law
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile "hplib==1.9" pandas==3.0.5 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" -W ignore - <<'EOF'
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

folder = Path(find_spec("hplib").submodule_search_locations[0])
machines = pd.read_csv(folder / "hplib_database.csv")
air = machines[machines["Type"] == "Outdoor Air/Water"]
power, heat = (air.groupby("Subtype")[f"MAPE_P_{of}"].median() for of in ("el", "th"))
missed = air.groupby("Subtype")["MAPE_P_el"].apply(lambda errors: (errors > 10.0).mean())
table = {"power, %": power, "heat, %": heat, "power missed by more than 10 %": missed}
print(pd.DataFrame(table).round(2).to_string())
assert power["On-Off"] < 5.0 < 10.0 < power["Regulated"]
assert heat["On-Off"] < 10.0 < heat["Regulated"]
assert missed["On-Off"] < 0.1 < 0.6 < missed["Regulated"]
EOF
