#!/usr/bin/env bash
# Three packages recalculate one workbook: -B1^2 is -9 by pycel, hours below 5 degC count lost readings by xlcalculator.
#
# Versions: pycel 1.0b30, formulas 1.3.4, xlcalculator 0.5.0, openpyxl 3.1.5
# A good guess: packages that compute Excel's formulas say what Excel says, where its documentation is clear: a sign comes before a
# power (-3^2 is 9), a month after 31 January is 28 February, empty cells are in no COUNTIF below 5 and in no AVERAGE, "<>" counts
# empty cells and text as not equal to 0
# Seen: pycel has -9 and 3 March, and of the root of -2, an error in Excel, -1.41 (formulas: a complex number). xlcalculator counts an
# empty cell as 0, so that three hours below 5 degC are four, and the mean of a column with a gap is an error. formulas leaves empty
# cells and text out of "<>0". Each is right where another one is not
# Why it matters: calculations of energy, contracts and bills live in workbooks: run by a program they give other numbers, unsaid
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pycel==1.0b30 "formulas[excel]==1.3.4" xlcalculator==0.5.0 openpyxl==3.1.5
cd "$work"
"$work/venv/bin/python" -W ignore - <<'PY'
import logging

import formulas
import openpyxl
import pycel
from xlcalculator import Evaluator, ModelCompiler

logging.disable()  # pycel tells of each function that it does not know
OUTDOORS = [3.0, None, 7.5, "off", -1.0, 0.0]
ASKED = {  # what Excel says; None where a package does not know the function
    "=-B3^2": 9,
    "=EDATE(DATE(2026,1,31),1)": 46081,
    '=COUNTIF(A1:A6,"<5")': 3,
    "=AVERAGE(A1:A6)": 2.375,
    '=SUMIFS(B1:B6,A1:A6,"<>0")': 15,
    "=(-2)^0.5": "#NUM!",
    "=ROUND(20.25,1)": 20.3,
    "=MOD(-1,24)": 23,
}
book = openpyxl.Workbook()
sheet = book.active
sheet.title = "S"
for row, outdoors in enumerate(OUTDOORS, 1):
    sheet.cell(row, 1).value = outdoors
    sheet.cell(row, 2).value = row
for row, formula in enumerate(ASKED, 1):
    sheet.cell(row, 4).value = formula
book.save("hours.xlsx")


def answer(ask, cell):
    """A number, or Excel's error, or None of a function that is not known."""
    try:
        value = ask(cell)
    except Exception:
        return None
    try:
        return round(float(value), 4)
    except (TypeError, ValueError):
        return str(value)


compiled = pycel.ExcelCompiler(filename="hours.xlsx")
evaluator = Evaluator(ModelCompiler().read_and_parse_archive("hours.xlsx"))
solved = formulas.ExcelModel().loads("hours.xlsx").finish().calculate()
ways = {
    "pycel": lambda cell: compiled.evaluate(f"S!{cell}"),
    "xlcalculator": lambda cell: evaluator.evaluate(f"S!{cell}"),
    "formulas": lambda cell: solved[f"'[hours.xlsx]S'!{cell}"].value[0, 0],
}
told = {
    name: {formula: answer(ask, f"D{row}") for row, formula in enumerate(ASKED, 1)} for name, ask in ways.items()
}
for formula, right in ASKED.items():
    print(f"{formula:27} Excel {right}", *(f"{name} {told[name][formula]}" for name in ways), sep=", ")
assert told["pycel"]["=-B3^2"] == -9 and told["formulas"]["=-B3^2"] == told["xlcalculator"]["=-B3^2"] == 9
assert told["pycel"]["=EDATE(DATE(2026,1,31),1)"] == 46084 and told["formulas"]["=EDATE(DATE(2026,1,31),1)"] == 46081
assert told["xlcalculator"]['=COUNTIF(A1:A6,"<5")'] == 4
assert told["pycel"]['=COUNTIF(A1:A6,"<5")'] == told["formulas"]['=COUNTIF(A1:A6,"<5")'] == 3
assert told["xlcalculator"]["=AVERAGE(A1:A6)"] == "#VALUE!"
assert told["pycel"]["=AVERAGE(A1:A6)"] == told["formulas"]["=AVERAGE(A1:A6)"] == 2.375
assert told["pycel"]['=SUMIFS(B1:B6,A1:A6,"<>0")'] == 15 and told["formulas"]['=SUMIFS(B1:B6,A1:A6,"<>0")'] == 9
assert told["pycel"]["=(-2)^0.5"] == -1.4142 and "j" in told["formulas"]["=(-2)^0.5"]
PY
