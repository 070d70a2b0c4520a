#!/usr/bin/env bash
# pymodbus' bits of a register: bit 0 is at index 8.
#
# Versions: pymodbus 3.16.1
# A good guess: `convert_from_registers([1], DATATYPE.BITS)` is a list of 16 whose first entry is bit 0 (or, written as people
# write binary numbers, whose last is)
# Seen: entry 8 is true. Bits 8 to 15 come first, then 0 to 7, each byte from its lowest bit; `word_order` does not change it,
# and of a double register bit 0 is at 8 or 24
# Why it matters: status words of heat pumps are read so (bit 0: compressor on, bit 8: fault): a running compressor is a fault
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pymodbus==3.16.1
"$work/venv/bin/python" - <<'EOF'
from pymodbus.client.mixin import ModbusClientMixin as Mixin

BITS = Mixin.DATATYPE.BITS


def at(registers, **order):
    return [index for index, bit in enumerate(Mixin.convert_from_registers(registers, BITS, **order)) if bit]


for bit in (0, 7, 8, 15):
    print(f"bit {bit} of a register is at {at([1 << bit])}")
assert [at([1 << bit]) for bit in (0, 7, 8, 15)] == [[8], [15], [0], [7]]
assert at([1, 0]) == [8]
assert at([1, 0], word_order="little") == [24]
assert Mixin.convert_to_registers([True] + [False] * 15, BITS) == [256]
EOF
