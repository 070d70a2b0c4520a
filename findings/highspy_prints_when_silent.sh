#!/usr/bin/env bash
# highspy 1.16 prints its banner and licence to standard output although output_flag is False; 1.15 prints nothing.
#
# Versions: highspy 1.16.0 beside 1.15.1
# A good guess: with output_flag False nothing is printed, as in every release before
# Seen: two lines on standard output at the first run in a process, by 1.16.0 only
# Why it matters: a command that writes JSON or CSV to standard output, or hands it to another program, is broken by a solve
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cat >"$work/program.py" <<'PY'
import highspy

model = highspy.Highs()
model.setOptionValue("output_flag", False)
model.addVar(0.0, 1.0)
model.run()
PY
for version in 1.15.1 1.16.0; do
  python3 -m venv "$work/$version"
  "$work/$version/bin/pip" install -q --no-compile highspy==$version numpy==2.4.6
  "$work/$version/bin/python" "$work/program.py" >"$work/said.$version"
  echo "highspy $version: $(wc -l <"$work/said.$version") lines: $(head -c 60 "$work/said.$version")"
done
test ! -s "$work/said.1.15.1"
grep -q "^Running HiGHS 1.16.0" "$work/said.1.16.0"
