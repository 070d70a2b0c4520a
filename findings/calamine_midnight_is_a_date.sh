#!/usr/bin/env bash
# python-calamine gives a workbook's stamps as datetimes, but the one at midnight as a date.
#
# Versions: python-calamine 0.9.1, openpyxl 3.1.5
# A good guess: a column of stamps comes back as a column of datetimes
# Seen: a cell whose number has no fraction is a datetime.date though its format shows hours; openpyxl gives a datetime.
# Sorting or subtracting the column raises TypeError; '#N/A' comes back as ''
# Why it matters: the first reading of each day of a logger's workbook is of another type: it is to be made a datetime
# before anything else
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile python-calamine==0.9.1 openpyxl==3.1.5
"$work/venv/bin/python" -W ignore - <<'EOF'
import tempfile
from datetime import date, datetime
from pathlib import Path

import openpyxl
from python_calamine import CalamineWorkbook

path = Path(tempfile.mkdtemp()) / "logger.xlsx"
book = openpyxl.Workbook()
for row, days in enumerate((45000.0, 45000.25, 45000.5), start=1):
    cell = book.active.cell(row, 1, days)
    cell.number_format = "yyyy-mm-dd hh:mm"
book.save(path)
calamine = [row[0] for row in CalamineWorkbook.from_path(str(path)).get_sheet_by_index(0).to_python()]
plain = [row[0] for row in openpyxl.load_workbook(path).active.iter_rows(values_only=True)]
print("calamine:", calamine, "\nopenpyxl:", plain)
assert [type(v) for v in calamine] == [date, datetime, datetime] and [type(v) for v in plain] == [datetime] * 3
try:
    sorted(calamine)
except TypeError as error:
    print("sorted:", error)
else:
    raise SystemExit("can be sorted")
EOF
