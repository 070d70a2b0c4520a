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

# Table 'Few-shot factual forecasting on REFIT', 19 homes, 3 days: method → RMSE K at 6 h, at 24 h.
FACTUAL: dict[str, tuple[float, float]] = {
    "persistence": (0.992, 1.263),
    "TSFM raw (zero-shot)": (0.458, 0.634),
    "RC full (weather oracle)": (0.663, 0.868),
    "RC persist-weather": (0.703, 1.241),
    "ThermoForce": (0.404, 0.628),
}

# Table 'Covariate-TSFM baselines', the same homes: method → RMSE K at 6 h, at 24 h.
COVARIATES: dict[str, tuple[float, float]] = {
    "TSFM raw (zero-shot)": (0.458, 0.634),
    "TSFM + covariates (ridge)": (0.594, 0.703),
    "TSFM + covariates + AR": (0.642, 0.959),
    "ThermoForce": (0.404, 0.628),
}

# Table 'Backbone generality', eight homes: backbone → million parameters, raw RMSE K, ThermoForce RMSE K.
BACKBONES: dict[str, tuple[float, float, float]] = {
    "chronos-bolt-tiny": (9.0, 0.537, 0.403),
    "chronos-bolt-mini": (21.0, 0.523, 0.409),
    "chronos-bolt-small": (48.0, 0.510, 0.396),
}

# Table 'Closed-loop key performance indicators': (window, controller) → energy kWh/m², discomfort K·h, cost EUR/m².
CLOSED_LOOP: dict[tuple[str, str], tuple[float, float, float]] = {
    ("peak A", "native"): (3.478, 8.382, 0.882),
    ("peak A", "rc_mpc_paper"): (3.128, 5.208, 0.793),
    ("peak A", "thermoforce_paper"): (3.160, 1.726, 0.801),
    ("peak B", "native"): (3.268, 8.292, 0.829),
    ("peak B", "rc_mpc_paper"): (2.994, 0.832, 0.759),
    ("peak B", "thermoforce_paper"): (2.990, 1.304, 0.758),
    ("typical", "native"): (1.773, 9.446, 0.449),
    ("typical", "rc_mpc_paper"): (1.721, 9.482, 0.436),
    ("typical", "thermoforce_paper"): (1.707, 6.352, 0.433),
}
