#!/usr/bin/env bash
# fastexcel, and polars through it, turn a text in row 1,300 of a column of numbers into an empty cell, without a word.
#
# Versions: fastexcel 0.21.0, polars 2.1.0
# A good guess: the column becomes text, or reading raises, as pandas and CSV readers do
# Seen: types are taken from the first 1,000 rows (100 where polars reads); "ERR" after them is null. Where the text stands
# in these rows the column is text
# Why it matters: "ERR", "off" or "n/a" of a logger in a workbook becomes a gap, and is filled like one; how a file is read
# depends on the row in which the fault happened
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile fastexcel==0.21.0 polars==2.1.0 openpyxl==3.1.5
cd "$work"
"$work/venv/bin/python" - <<'EOF'
import fastexcel
import openpyxl
import polars as pl


def read(row):
    book = openpyxl.Workbook()
    book.active.append(["zone", "n"])
    for i in range(1, 1501):
        book.active.append(["ERR" if i == row else 20.5, i])
    book.save("log.xlsx")
    return fastexcel.read_excel("log.xlsx").load_sheet(0).to_polars(), pl.read_excel("log.xlsx")


for row, texts in ((50, (True, True)), (300, (True, False)), (1300, (False, False))):
    for reader, table, text in zip(("fastexcel", "polars"), read(row), texts, strict=True):
        print(f"{reader}: ERR in row {row}: column of {table['zone'].dtype}, cell {table['zone'][row - 1]!r}")
        assert table["zone"].dtype == (pl.String if text else pl.Float64)
        assert table["zone"][row - 1] == ("ERR" if text else None)
EOF
