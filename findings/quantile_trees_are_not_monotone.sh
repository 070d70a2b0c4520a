#!/usr/bin/env bash
# scikit-learn's and XGBoost's boosted quantiles fall where monotone constraints told them to rise.
#
# Versions: scikit-learn 1.9.1, xgboost 3.2.0; lightgbm 4.7.0, catboost 1.2.10
# A good guess: a monotone constraint holds whatever the loss, or the pair is refused; it holds for squared errors in all four
# Seen: with the loss of a quantile, or of absolute errors, HistGradientBoostingRegressor and XGBRegressor fit without a word, and
# of the steps at which the prediction changes a tenth to a third go down, the deepest further than the whole way from no heat to
# full: leaves get the quantile of what fell into them after the constraint was kept. XGBoost's "exact" trees keep it;
# LightGBM refuses the pair, CatBoost keeps the constraint
# Why it matters: a band of a room's temperature or of heat by level, believed to rise with the level, says that less heating
# warms; a check with squared errors does not show it
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile scikit-learn==1.9.1 xgboost==3.2.0 lightgbm==4.7.0 catboost==1.2.10 numpy==2.4.6
cd "$work"
OMP_NUM_THREADS=1 "$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from catboost import CatBoostRegressor
from lightgbm import LGBMRegressor
from lightgbm.basic import LightGBMError
from sklearn.ensemble import HistGradientBoostingRegressor
from xgboost import XGBRegressor

rng = np.random.default_rng(0)
level, other = rng.uniform(0, 1, 2000), rng.uniform(-1, 1, 2000)
rooms = 2 * level + np.sin(4 * other) + (0.3 + 0.7 * abs(other)) * rng.standard_t(3, 2000)
grid = np.linspace(0, 1, 401)


def falls(name, model):
    """Share of the steps at which the prediction changes that go down, from the lowest level to the highest."""
    model.fit(np.c_[level, other], rooms)
    steps = np.concatenate([np.diff(model.predict(np.c_[grid, np.full(401, at)]).ravel()) for at in np.linspace(-0.9, 0.9, 7)])
    share = float((steps < -1e-6).sum() / (abs(steps) > 1e-6).sum())
    print(f"{name}: {share:.0%} of the steps fall, the deepest by {-steps.min():.2f}")
    return share


def sklearn(loss, **more):
    return falls(f"scikit-learn, {loss} {more or ''}", HistGradientBoostingRegressor(loss=loss, monotonic_cst=[1, 0], **more))


def xgboost(loss, tree="hist", **more):
    model = XGBRegressor(objective=loss, monotone_constraints=(1, 0), tree_method=tree, n_jobs=1, **more)
    return falls(f"XGBoost, {loss} {tree} {more or ''}", model)


def catboost(loss):
    options = {"iterations": 200, "verbose": 0, "thread_count": 1, "allow_writing_files": False}
    return falls(f"CatBoost, {loss}", CatBoostRegressor(loss_function=loss, monotone_constraints=[1, 0], **options))


assert sklearn("squared_error") == xgboost("reg:squarederror") == catboost("RMSE") == 0
assert sklearn("absolute_error") > 0.05 and xgboost("reg:absoluteerror") > 0.1
for quantile in (0.1, 0.9):
    assert sklearn("quantile", quantile=quantile) > 0.1
    assert xgboost("reg:quantileerror", quantile_alpha=quantile) > 0.2
    assert xgboost("reg:quantileerror", "exact", quantile_alpha=quantile) == 0 == catboost(f"Quantile:alpha={quantile}")
try:
    LGBMRegressor(objective="quantile", monotone_constraints=[1, 0], n_jobs=1).fit(np.c_[level, other], rooms)
    raise SystemExit("LightGBM takes it")
except LightGBMError as refused:
    print("LightGBM:", refused)
EOF
