#!/usr/bin/env bash
# One NaN: STL, MSTL and Holt-Winters of statsmodels return nothing but NaN; their neighbours raise.
#
# Versions: statsmodels 0.15.0
# A good guess: STL and ExponentialSmoothing raise on a missing value, as seasonal_decompose and AutoReg do
# Seen: STL, MSTL, ExponentialSmoothing and ETSModel return all NaN (Holt-Winters with a warning about convergence, not
# about the gap); seasonal_decompose raises ValueError, AutoReg MissingDataError
# Why it matters: a band or a baseline of a building becomes empty for a lost minute, and nothing says why
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile statsmodels==0.15.0 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from statsmodels.tsa.ar_model import AutoReg
from statsmodels.tsa.holtwinters import ExponentialSmoothing
from statsmodels.tsa.seasonal import MSTL, STL, seasonal_decompose
from statsmodels.tools.sm_exceptions import MissingDataError

y = np.sin(np.arange(240) * 2 * np.pi / 24)
y[50] = np.nan
silent = {
    "STL": STL(y, period=24).fit().trend,
    "MSTL": MSTL(y, periods=(24,)).fit().trend,
    "Holt-Winters": ExponentialSmoothing(y, seasonal="add", seasonal_periods=24).fit().forecast(3),
}
for name, values in silent.items():
    print(name, "NaN:", int(np.isnan(values).sum()), "of", len(values))
    assert np.isnan(values).all()
for method, error in ((lambda: seasonal_decompose(y, period=24), ValueError), (lambda: AutoReg(y, 3).fit(), MissingDataError)):
    try:
        method()
    except error as said:
        print(type(said).__name__, said)
    else:
        raise SystemExit("taken")
EOF
