"""Figures printed in the paper, shown beside measured ones for comparison; not used in any computation."""

from __future__ import annotations

# Table 'Interventional validity': (method, climate) → factual RMSE K, effect RMSE K, sign accuracy.
INTERVENTIONAL_VALIDITY: dict[tuple[str, str], tuple[float | None, float, float]] = {
    ("tsfm", "heating_chicago"): (0.817, 1.439, 0.00),
    ("tsfm_covariates", "heating_chicago"): (0.817, 0.905, 0.78),
    ("rc", "heating_chicago"): (0.761, 1.360, 0.93),
    ("surrogate", "heating_chicago"): (None, 4.010, 0.76),
    ("thermoforce_unconstrained", "heating_chicago"): (0.817, 0.759, 0.85),
    ("thermoforce", "heating_chicago"): (0.817, 0.751, 0.85),
    ("tsfm", "cooling_phoenix"): (0.749, 0.640, 0.00),
    ("tsfm_covariates", "cooling_phoenix"): (0.749, 0.331, 0.68),
    ("rc", "cooling_phoenix"): (1.391, 0.640, 0.01),
    ("surrogate", "cooling_phoenix"): (None, 0.552, 0.90),
    ("thermoforce_unconstrained", "cooling_phoenix"): (0.749, 0.331, 0.96),
    ("thermoforce", "cooling_phoenix"): (0.749, 0.245, 0.95),
}

# Table 'Operator ablation': (gain, days) → effect RMSE K on DR-down, DR-up.
OPERATOR_ABLATION: dict[tuple[str, int], tuple[float, float]] = {
    ("linear", 1): (0.445, 0.570),
    ("linear", 3): (0.390, 0.510),
    ("linear", 7): (0.386, 0.497),
    ("linear", 30): (0.384, 0.489),
    ("neural", 1): (0.448, 0.486),
    ("neural", 3): (0.371, 0.459),
    ("neural", 7): (0.313, 0.453),
    ("neural", 30): (0.318, 0.430),
}

# Table 'Computational cost', ms, and the number of parameters.
EFFICIENCY_MS: dict[str, float] = {
    "RC identification (3 days)": 24.0,
    "operator training": 5600.0,
    "forced rollout (24 steps)": 2.1,
    "free forecast (512 to 24)": 30.0,
}
PARAMETERS = 195
