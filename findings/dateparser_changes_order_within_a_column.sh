#!/usr/bin/env bash
# dateparser reads 03.11.2025 as 11 March and, in the next row, 13.11.2025 as 13 November.
#
# Versions: dateparser 1.5.0
# A good guess: dots mean day first, as everywhere where dates are written with dots; or the order is one for a column
# Seen: with default settings the order is month first whenever that is possible, for dots, slashes and dashes alike;
# one word of German beside the date ('Uhr') turns it; nothing is said. Given languages=['de'] it is right
# Why it matters: the first twelve days of each month of an export land in other months, and the table still has nearly
# as many rows: the language is to be said, or the format
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile dateparser==1.5.0
"$work/venv/bin/python" -W ignore - <<'EOF'
import dateparser

first, second = dateparser.parse("03.11.2025 14:15"), dateparser.parse("13.11.2025 14:15")
word = dateparser.parse("12.11.2025 14:15 Uhr")
german = dateparser.parse("03.11.2025 14:15", languages=["de"])
print(first, second, word, german, sep="\n")
assert (first.month, first.day) == (3, 11) and (second.month, second.day) == (11, 13)
assert (word.month, word.day) == (11, 12) and (german.month, german.day) == (11, 3)
EOF
