#!/usr/bin/env bash
# The number of threads of HiGHS is that of its first solve in the process: later solves with another one fail.
#
# Versions: highspy 1.15.1
# A good guess: `threads` is an option of one solver object; setOptionValue says kOk, so each may have its own
# Seen: the second solver takes `threads` 2 (kOk), and run() is kError with the model status kNotset; 0 works always
# Why it matters: two packages in one process, or one test before another, decide whether a controller has a plan
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile highspy==1.15.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import highspy
import numpy as np


def knapsack(threads):
    """Status of a small choice among thirty, by so many threads; 0: as HiGHS likes."""
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    assert solver.setOptionValue("threads", threads) == highspy.HighsStatus.kOk
    rng = np.random.default_rng(0)
    for i, worth in enumerate(rng.uniform(1.0, 2.0, 30)):
        solver.addVariable(0.0, 1.0, -worth)
        solver.changeColIntegrality(i, highspy.HighsVarType.kInteger)
    solver.addRow(-highspy.kHighsInf, 7.3, 30, np.arange(30, dtype=np.int32), rng.uniform(0.5, 1.5, 30))
    status = solver.run()
    print(f"threads {threads}: {status.name}, {solver.getModelStatus().name}")
    return status.name, solver.getModelStatus().name


assert knapsack(1) == ("kOk", "kOptimal")
assert knapsack(2) == ("kError", "kNotset")
assert knapsack(0) == ("kOk", "kOptimal")
EOF
