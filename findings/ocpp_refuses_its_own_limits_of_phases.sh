#!/usr/bin/env bash
# ocpp cannot send OCPP 2.1's limits for the second and third phase: of its own data classes it makes names that it refuses.
#
# Versions: ocpp 2.1.0
# A good guess: a charging profile built of the library's own data classes goes out under the names of the protocol, limit_L2, limit_L3,
# setpoint_L2 and so on, and validates
# Seen: the classes have the fields limit_l2, limit_l3, setpoint_l2; names on the wire are made of them by rule, limitL2 and so on, which
# the schema does not know: "Additional properties are not allowed". Without validation they go out so. What comes in under the true
# names is read into those fields
# Why it matters: a house with a heat pump on one phase cannot hold a car down on the others, or, with validation off, tells a station
# limits that it does not read
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile ocpp==2.1.0
"$work/venv/bin/python" - <<'EOF'
import asyncio
import json
from pathlib import Path

import ocpp.v21
from ocpp.charge_point import camel_to_snake_case
from ocpp.exceptions import FormatViolationError
from ocpp.v21 import ChargePoint, call
from ocpp.v21.datatypes import ChargingProfileType, ChargingSchedulePeriodType, ChargingScheduleType

SENT = []


class Line:
    """What a station would hear."""

    async def send(self, text):
        SENT.append(json.loads(text)[3])


async def set_profile(limits, **how):
    """Send a profile of one period; nobody answers here."""
    period = ChargingSchedulePeriodType(start_period=0, **limits)
    schedule = ChargingScheduleType(id=1, charging_rate_unit="A", charging_schedule_period=[period])
    profile = ChargingProfileType(
        id=1, stack_level=0, charging_profile_purpose="TxDefaultProfile", charging_profile_kind="Absolute", charging_schedule=[schedule]
    )
    station = ChargePoint("garage", Line(), response_timeout=0.1)
    try:
        await station.call(call.SetChargingProfile(evse_id=1, charging_profile=profile), **how)
    except asyncio.TimeoutError:
        pass


def period_sent():
    return SENT.pop()["chargingProfile"]["chargingSchedule"][0]["chargingSchedulePeriod"][0]


phases = {"limit": 16.0, "limit_l2": 6.0, "limit_l3": 6.0, "setpoint_l2": 6.0}
asyncio.run(set_profile({"limit": 16.0}))
assert period_sent() == {"startPeriod": 0, "limit": 16.0}
said = ""
try:
    asyncio.run(set_profile(phases))
except FormatViolationError as error:
    said = error.details["cause"]
print("refused:", said)
assert "'limitL2', 'limitL3', 'setpointL2' were unexpected" in said and not SENT
asyncio.run(set_profile(phases, skip_schema_validation=True))
period = period_sent()
print("without validation:", period)
schema = json.loads((Path(ocpp.v21.__file__).parent / "schemas" / "SetChargingProfileRequest.json").read_text(encoding="utf-8-sig"))
known = schema["definitions"]["ChargingSchedulePeriodType"]["properties"]
assert sorted(period.keys() - known.keys()) == ["limitL2", "limitL3", "setpointL2"]
assert {"limit_L2", "limit_L3", "setpoint_L2"} <= known.keys()
assert camel_to_snake_case({"limit_L2": 6.0}) == {"limit_l2": 6.0}
EOF
