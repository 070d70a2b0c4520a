#!/usr/bin/env bash
# pyMeterBus reads what a heat meter sends instead of a number as a number: 141.4 degC, -3276.8 degC.
#
# Versions: pyMeterBus 0.8.5
# A good guess: EN 13757-3 has codes for "no value" (digits A to E in BCD, 8000 hex as a 16-bit integer, the function field
# "value during error state"): they come back as None or an error, or the record is marked
# Seen: BCD EEEE is 141.4 degC, DDDD 131.3, 8000 hex -3276.8; the digits are added up as 10 to 14. F in the highest digit
# is a minus, as the standard says. The error state stands in `interpreted` only; `value` is what was read
# Why it matters: a broken flow sensor is a believable-looking hot supply, and its energy is negative without bound
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pyMeterBus==0.8.5
"$work/venv/bin/python" -W ignore - <<'EOF'
import meterbus


def flow_temperature(kind, data):
    """The value of one record (VIF 5A: flow temperature, 0.1 degC) in an answer of a meter."""
    head = bytes([0x08, 0x01, 0x72]) + bytes.fromhex("785634122440010401000000")
    body = head + bytes([kind, 0x5A]) + bytes.fromhex(data)
    frame = bytes([0x68, len(body), len(body), 0x68]) + body + bytes([sum(body) % 256, 0x16])
    return float(meterbus.load(frame).records[0].value)


BCD, INTEGER = 0x0A, 0x02
for kind, data, seen in ((BCD, "4502", 24.5), (BCD, "45F0", -4.5), (BCD, "EEEE", 141.4), (BCD, "DDDD", 131.3), (INTEGER, "0080", -3276.8)):
    value = flow_temperature(kind, data)
    print(f"{data}: {value:.1f} degC")
    assert abs(value - seen) < 1e-6
EOF
