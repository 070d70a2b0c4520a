#!/usr/bin/env bash
# One missing value in a series of temperatures, and statsforecast's AutoARIMA forecasts exactly 0 for ever.
#
# Versions: statsforecast 2.1.1
# A good guess: an error, as AutoETS, MSTL and AutoTheta give one, or a forecast that passes over the gap
# Seen: forecasts of 0.0 for a series around 10, no warning; HistoricAverage and WindowAverage give NaN; a second row of
# the same hour is taken without a word
# Why it matters: a free response of 0 degC asks for full heat; gaps of a logger are to be filled before
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile statsforecast==2.1.1 pandas==2.3.3 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import pandas as pd
from statsforecast import StatsForecast
from statsforecast.models import AutoARIMA, AutoETS, SeasonalNaive

y = 10 + np.sin(np.arange(240) * 2 * np.pi / 24)
gap = y.copy()
gap[100] = np.nan


def forecast(model, series):
    frame = pd.DataFrame({"unique_id": "zone", "ds": pd.date_range("2025-01-01", periods=240, freq="h"), "y": series})
    return StatsForecast([model], freq="h", n_jobs=1).forecast(df=frame, h=3).iloc[:, -1].tolist()


def arima():
    return AutoARIMA(max_p=1, max_q=1, seasonal=False)


print("AutoARIMA, complete:", forecast(arima(), y), "one value missing:", forecast(arima(), gap))
assert all(8 < v < 12 for v in forecast(arima(), y)) and forecast(arima(), gap) == [0, 0, 0]
assert all(8 < v < 12 for v in forecast(SeasonalNaive(24), gap))
try:
    forecast(AutoETS(season_length=24, model="ANA"), gap)
except ValueError as error:
    print("AutoETS:", error)
else:
    raise SystemExit("AutoETS took the gap")
EOF
