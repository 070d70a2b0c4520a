#!/usr/bin/env bash
# xlsx2csv writes 21.5 in a cell that shows "21.5 kWh" as the text `0.0" kw12"`, 0.8 kWh as 19:12, and 26.5 hours as 02:30.
#
# Versions: xlsx2csv 0.8.6, openpyxl 3.1.5
# A good guess: a cell is a number whatever unit its format shows; a running time of 26:30:00 is 26.5 h or 26:30:00
# Seen: a format in which h, s, m, d or y stands, also between quotation marks (kWh, MWh, m³/h, min, ppm, mbar, ct/kWh), makes a
# date of every number from 1 on, so that the number is lost, and a time of day of one below 1. Negative numbers stay. kW, °C, bar
# and K stay, with as many zeros as the format has letters. A duration of [h]:mm:ss loses its whole days. openpyxl reads all right
# Why it matters: exports of meters carry units in such formats: the column is text, or energies below 1 kWh are times of day
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile xlsx2csv==0.8.6 openpyxl==3.1.5
cd "$work"
"$work/venv/bin/python" - <<'PY'
import csv
import datetime

import openpyxl
from xlsx2csv import Xlsx2csv

READ = {
    '0.0" kWh"': ['0.0" kw12"', "19:12", "-3.5000000"],
    '0.0" MWh"': ['0.0" 01w12"', "19:12", "-3.5000000"],
    '0.0" m³/h"': ['0.0" 01³/12"', "19:12", "-3.50000000"],
    '0.0" min"': ['0.0" 01in"', "19:12", "-3.5000000"],
    '0" ppm"': ['0" pp01"', "19:12", "-3.5"],
    '0.0" kW"': ["21.500000", "0.800000", "-3.500000"],
    '0.0" °C"': ["21.500000", "0.800000", "-3.500000"],
}
book = openpyxl.Workbook()
for shape in READ:
    book.active.append([shape, 21.5, 0.8, -3.5])
    for cell in book.active[book.active.max_row][1:]:
        cell.number_format = shape
book.active.append(["run", datetime.timedelta(hours=26.5)])
book.active.cell(book.active.max_row, 2).number_format = "[h]:mm:ss"
book.save("meter.xlsx")

*rows, run = openpyxl.load_workbook("meter.xlsx").active.iter_rows(values_only=True)
assert all(row[1:] == (21.5, 0.8, -3.5) for row in rows) and run[1] == datetime.timedelta(hours=26.5)
Xlsx2csv("meter.xlsx", outputencoding="utf-8").convert("meter.csv")
*rows, run = csv.reader(open("meter.csv", encoding="utf-8"))
for shape, *cells in rows:
    print(f"{shape:12} 21.5, 0.8, -3.5 -> {', '.join(cells)}")
    assert cells == READ[shape]
print("26 h 30 min ->", run[1])
assert run[1] == "02:30"
PY
