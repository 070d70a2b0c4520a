#!/usr/bin/env bash
# aemo-to-tariff: one instant has two prices, as it is given in UTC or in local time: Monday morning's peak is then Sunday's off-peak.
#
# Versions: aemo-to-tariff 0.7.28
# A good guess: spot_to_tariff takes an instant with its zone; networks' windows go by their own clock, so that 07:30 in Sydney and the
# same instant in UTC, in which the market's data often are, have one price
# Seen: the hour is taken on the network's clock, the day of the week as it was given. Of Essential's BLNT3AU, TasNetworks' TAS94 and
# Victoria's VICR_TOU instants in UTC have another price in six hours of a week: Monday mornings from seven to ten count as Sunday, and
# Saturday mornings as Friday. Other networks ask for neither day or ask right (ausgrid, energex, sapn: none differ)
# Why it matters: a heat pump that is planned on such prices runs through Monday's peak at twice what was thought, and waits on Saturday
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile aemo-to-tariff==0.7.28 tzdata==2025.2
"$work/venv/bin/python" - <<'EOF'
from datetime import datetime, timedelta, timezone
from zoneinfo import ZoneInfo

from aemo_to_tariff import spot_to_tariff

MONDAY = datetime(2026, 8, 3, tzinfo=ZoneInfo("Australia/Sydney"))
WEEK = [MONDAY + timedelta(minutes=5 * i) for i in range(7 * 288)]


def apart(network, tariff):
    """Instants of a week, every 5 min, with one price in local time and another in UTC, c/kWh at 100 AUD/MWh."""
    both = [(at, *(spot_to_tariff(one, network, tariff, 100.0) for one in (at, at.astimezone(timezone.utc)))) for at in WEEK]
    return [(at, local, utc) for at, local, utc in both if abs(local - utc) > 1e-9]


for network, tariff in (("essential", "BLNT3AU"), ("tasnetworks", "TAS94"), ("victoria", "VICR_TOU")):
    found = apart(network, tariff)
    (first, local, utc), hours = found[0], len(found) / 12
    print(f"{network} {tariff}: {hours:g} h a week; {first:%a %H:%M} {local:.2f} c/kWh, the same instant in UTC {utc:.2f}")
    assert hours == 6.0 and f"{first:%a}" == "Mon" and local > utc + 5.0
    assert {f"{at:%a}" for at, _, _ in found} == {"Mon", "Sat"}
for network, tariff in (("ausgrid", "EA025"), ("energex", "6900"), ("sapn", "RTOU")):
    assert not apart(network, tariff), network
EOF
