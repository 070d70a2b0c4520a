#!/usr/bin/env bash
# SheetJS' xlsx reads a third of a workbook's quarter hours as a millisecond before: 00:15 is 00:14:59.999.
#
# Versions: xlsx 0.18.5 (the last one on npm), exceljs 4.4.0, Node.js 20; workbook by openpyxl 3.1.5
# A good guess: with cellDates the stamps of a workbook come as they stand in it
# Seen: of 3840 stamps, one in 15 min, 1280 are 1 ms early, so that a third of all rows say :14, :29, :44 or :59 of the hour
# before; at a time zone with a full hour's offset. exceljs reads all of them exactly
# Why it matters: rows are put into quarter hours by their stamps: in a third of them is nothing and in a third is two, and the
# reading of midnight belongs to the day before
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm install --silent --no-audit --no-fund --ignore-scripts xlsx@0.18.5 exceljs@4.4.0 >npm.log 2>&1
python3 -m venv venv
venv/bin/pip install -q --no-compile openpyxl==3.1.5
venv/bin/python - <<'PY'
from datetime import datetime, timedelta

import openpyxl

book = openpyxl.Workbook()
for row in range(40 * 96):
    book.active.append([datetime(2025, 1, 1) + row * timedelta(minutes=15), 21.5])
book.save("house.xlsx")
PY
cat > read.js <<'JS'
const assert = require("assert"), XLSX = require("xlsx"), ExcelJS = require("exceljs");
const counted = (minutes) => Object.entries(minutes.reduce((n, m) => ({ ...n, [m]: (n[m] || 0) + 1 }), {}));
(async () => {
  const book = XLSX.readFile("house.xlsx", { cellDates: true });
  const rows = XLSX.utils.sheet_to_json(book.Sheets[book.SheetNames[0]], { header: 1 });
  const early = rows.filter(([at]) => at.getMinutes() % 15);
  console.log("xlsx: minutes", JSON.stringify(counted(rows.map(([at]) => at.getMinutes()))), "row 2:", rows[1][0].toString());
  const exact = await new ExcelJS.Workbook().xlsx.readFile("house.xlsx");
  const minutes = exact.worksheets[0].getColumn(1).values.slice(1).map((at) => at.getUTCMinutes());
  console.log("exceljs: minutes", JSON.stringify(counted(minutes)));
  assert.strictEqual(early.length, 1280);
  assert.ok(early.every(([at]) => at.getMilliseconds() === 999) && minutes.every((m) => m % 15 === 0));
})();
JS
TZ=Europe/Vienna node read.js
