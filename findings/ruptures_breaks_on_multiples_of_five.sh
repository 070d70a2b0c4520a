#!/usr/bin/env bash
# ruptures reports a clean step at sample 103 as 105: by default it looks at every fifth sample only, its exact method too.
#
# Versions: ruptures 1.1.10
# A good guess: a step without noise worth naming is found where it is, 103; "Pelt" and "Dynp" are exact methods
# Seen: Pelt, Binseg, BottomUp and Window say 105 (`jump=5` is the default); Dynp too; with jump=1 Pelt says 103, and
# KernelCPD, which has no jump, says 103 as it is
# Why it matters: of 15-minute readings the change of a schedule, a new set-point or a sensor that was moved is said up to
# half an hour beside where it is, and a law fitted to "before" holds steps of "after"
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile ruptures==1.1.10 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
import ruptures as rpt

step = np.r_[np.zeros(103), np.ones(97)] + 0.01 * np.random.default_rng(0).normal(size=200)
seen = {
    "Pelt": rpt.Pelt(model="l2").fit(step).predict(pen=1)[0],
    "Dynp": rpt.Dynp(model="l2").fit(step).predict(n_bkps=1)[0],
    "Binseg": rpt.Binseg(model="l2").fit(step).predict(n_bkps=1)[0],
    "Pelt, jump=1": rpt.Pelt(model="l2", jump=1).fit(step).predict(pen=1)[0],
    "KernelCPD": rpt.KernelCPD("linear").fit(step).predict(n_bkps=1)[0],
}
print("a step at 103 is reported at", {name: int(at) for name, at in seen.items()})
assert seen["Pelt"] == seen["Binseg"] == 105
assert seen["Pelt, jump=1"] == seen["KernelCPD"] == 103
EOF
