#!/usr/bin/env bash
# pint reads cfm as a length of 1e-17 m, ct/kWh as carats per energy, and refuses degC/h and m3/h.
#
# Versions: pint 0.25.3
# A good guess: cfm is cubic feet per minute or unknown, ct is unknown, degC/h is a rate, m3 is unknown
# Seen: cfm: centi-femto-metre; ct: carat; degC/h: an error about offset units when parsed; m3/h: unknown, though m³/h
# is known
# Why it matters: headers of building automation and of bills ('Supply air flow [cfm]', 'Price [ct/kWh]') get a unit
# that is no error, only another quantity: dimensions are to be checked after parsing
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pint==0.25.3
"$work/venv/bin/python" -W ignore - <<'EOF'
import pint

units = pint.UnitRegistry()
flow, price = units("1 cfm"), units("30 ct/kWh")
print(flow.to("m"), "|", price.to_base_units(), "|", (1 * units.ct).to("g"))
assert flow.check("[length]") and abs(flow.to("m").magnitude - 1e-17) < 1e-30
assert price.check("[mass] / [energy]") and abs((1 * units.ct).to("g").magnitude - 0.2) < 1e-12
for text, error in (("degC/h", pint.errors.OffsetUnitCalculusError), ("m3/h", pint.errors.UndefinedUnitError)):
    try:
        units(text)
    except error as said:
        print(text, "->", str(said)[:60])
    else:
        raise SystemExit(f"{text} was taken")
assert units("1 m³/h").check("[length] ** 3 / [time]")
EOF
