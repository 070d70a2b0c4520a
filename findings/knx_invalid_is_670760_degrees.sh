#!/usr/bin/env bash
# KNX says "no valid reading" as 7FFF; both KNX libraries of Node.js read 670,760.96 °C, and they write null as 0 °C.
#
# Versions: knx 2.5.4, knxultimate 5.4.0 (npm; the latter under Node-RED's KNX nodes), Node.js 20; xknx 4.0.0 (Python) in comparison
# A good guess: 7FFF, which KNX keeps for invalid data in all its two-byte floats (DPT 9), is no number; null is refused, or is not
# sent; what is above the range is refused or cut off
# Seen: 7FFF is 670760.96 in both. null is encoded as 0.00 without a word; 700000 as a negative number. xknx refuses
# Why it matters: a room sensor whose element is broken shows a temperature of 670,760.96 °C, and one such value stays in every mean; a
# controller that says null for "your own control" sets 0 °C
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm install --silent --no-audit --no-fund --ignore-scripts knx@2.5.4 knxultimate@5.4.0 >npm.log 2>&1
python3 -m venv venv
venv/bin/pip install -q --no-compile xknx==4.0.0
cat > read.js <<'JS'
const assert = require("assert");
const kinds = {
  "knx 2.5.4": require("knx/src/dptlib/dpt9.js"),
  "knxultimate 5.4.0": require("knxultimate/build/dptlib/dpt9.js").default,
};
for (const [name, dpt9] of Object.entries(kinds)) {
  const there = (value) => dpt9.fromBuffer(dpt9.formatAPDU(value));
  const invalid = dpt9.fromBuffer(Buffer.from([0x7f, 0xff]));
  console.log(name, "| 21.5 ->", there(21.5), "| 7FFF ->", invalid, "| null ->", there(null), "| 700000 ->", there(700000));
  assert.ok(there(21.5) === 21.5 && invalid === 670760.96 && there(null) === 0 && there(700000) < 0);
}
JS
node read.js
venv/bin/python - <<'PY'
from xknx.dpt import DPTArray, DPTTemperature
from xknx.exceptions import ConversionError, CouldNotParseTelegram

for what in (lambda: DPTTemperature.from_knx(DPTArray((0x7F, 0xFF))), lambda: DPTTemperature.to_knx(700000)):
    try:
        raise SystemExit(f"xknx took it: {what()}")
    except (ConversionError, CouldNotParseTelegram) as error:
        print("xknx:", type(error).__name__)
PY
