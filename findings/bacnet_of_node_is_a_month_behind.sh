#!/usr/bin/env bash
# node-bacnet and bacstack write 24 December as 24 November on the wire, and read it as 24 January; "any year" becomes 2156.
#
# Versions: node-bacnet 0.2.4, bacstack 0.0.1-beta.14 (npm), Node.js 20; bacpypes3 0.0.110 (Python) in comparison
# A good guess: months are 1 to 12 as the standard has them, those of JavaScript's Date are turned into them; FF (any) stays a pattern
# Seen: the month of Date, 0 to 11, goes to the wire as it is, in values and in time synchronisation, and what comes is taken for
# one: both directions agree with each other and with no other device. January is month 0, which is none. Any year is 2156, any
# date is 1 February 1901, any day of December 2025 is 12 September 2026
# Why it matters: a gateway in Node.js that sets the clock of controllers, or their holidays, does so a month early; of a day
# off each 24 December it shows one day in 2156
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm install --silent --no-audit --no-fund --ignore-scripts node-bacnet@0.2.4 bacstack@0.0.1-beta.14 >npm.log 2>&1
python3 -m venv venv
venv/bin/pip install -q --no-compile bacpypes3==0.0.110
cat > dates.js <<'JS'
const assert = require("assert");
for (const name of ["node-bacnet", "bacstack"]) {
  const asn1 = require(`${name}/lib/asn1.js`), { timeSync } = require(`${name}/lib/services`);
  const bytes = (write) => {
    const to = { buffer: Buffer.alloc(16), offset: 0 };
    write(to);
    return [...to.buffer.subarray(0, to.offset)];
  };
  const date = bytes((to) => asn1.encodeApplicationDate(to, new Date(2025, 11, 24)));
  const clock = bytes((to) => timeSync.encode(to, new Date(2026, 0, 31, 6, 30)));
  const read = (...from) => asn1.decodeDate(Buffer.from(from), 0).value.toLocaleDateString("sv");
  console.log(`${name}: 24 December 2025 -> ${date.slice(1)}; clock of 31 January 2026 -> ${clock.slice(1, 5)}`);
  console.log("  125,12,24,3 ->", read(125, 12, 24, 3), " any,12,24,any ->", read(255, 12, 24, 255), " any ->", read(255, 255, 255, 255));
  assert.deepStrictEqual([date[2], clock[2]], [11, 0]);
  assert.deepStrictEqual([read(125, 12, 24, 3), read(255, 12, 24, 255)], ["2026-01-24", "2156-01-24"]);
  assert.strictEqual(read(125, 12, 255, 255), "2026-09-12");
}
JS
TZ=UTC node dates.js
venv/bin/python - <<'PY'
from bacpypes3.primitivedata import Date

date = Date("2025-12-24").encode()[0].tag_data
print("bacpypes3:", list(date), "for 24 December 2025")
assert list(date) == [125, 12, 24, 3]
PY
