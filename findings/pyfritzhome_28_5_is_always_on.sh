#!/usr/bin/env bash
# pyfritzhome sets a radiator thermostat to "always on" where 28.5 °C are asked for, and reads one that is off as 126.5 °C.
#
# Versions: pyfritzhome 0.6.21
# A good guess: beyond the device's 8 to 28 °C a set-point is held at the bound, or refused; what is between the half degrees is
# rounded; a thermostat that is off or always on has no set-point
# Seen: above 28 °C the valve is open until somebody sets it anew (code 254), below 8 °C off, without protection from frost
# (code 253); 21.99 °C is set as 21.5; off reads as 126.5 °C, always on as 127 °C
# Why it matters: a controller that pre-heats to 28.5 °C heats without end, and one that reads set-points takes 126.5 °C for one
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pyfritzhome==0.6.21
"$work/venv/bin/python" - <<'EOF'
from pyfritzhome import Fritzhome

SENT = []


class Box(Fritzhome):
    """A box that notes what is sent to it, and answers with the code of a thermostat that is off or always on."""

    answer = 0

    def _aha_request(self, cmd, ain=None, param=None, rf=str):
        SENT.append((param or {}).get("param"))
        return rf(self.answer)


box = Box("fritz.box", "user", "password")
for asked in (21.5, 21.99, 28.0, 28.5, 8.0, 7.9):
    box.set_target_temperature("1", asked)
    code = SENT[-1]
    print(f"{asked} °C -> {code}:", {253: "off", 254: "always on"}.get(code, f"{code / 2} °C"))
assert SENT == [43, 43, 56, 254, 16, 253]
for Box.answer, state in ((253, "off"), (254, "always on")):
    read = box.get_target_temperature("1")
    print(f"{state} -> {read} °C")
    assert read == Box.answer / 2
EOF
