#!/usr/bin/env bash
# timesfm 3: a series without covariates is forecast otherwise when another series of the same call has covariates.
#
# Versions: timesfm 3.0.2, torch 2.13.0
# A good guess: predict_batch forecasts each series as predict does, whatever stands beside it
# Seen: so it is beside series of other levels and lengths, to 2e-6 K. Beside one with past_future_covariates a series
# given None gets covariates of zeros, which the model reads as data: the forecast moves by as much as it spreads
# Why it matters: a fleet in which one building has a weather forecast changes the plans of those that have none; forecast
# them in a call of their own
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile timesfm==3.0.2 torch==2.13.0
"$work/venv/bin/python" -W ignore - "$work/model" <<'EOF'
import sys

import numpy as np
import torch
from timesfm3 import (
    ResidualBlockConfig,
    StackedTransformersConfig,
    TimesFM3Forecaster,
    TimesFM3Torch,
    TransformerConfig,
)

torch.manual_seed(0)
rms = {"attention_norm": "rms", "feedforward_norm": "rms", "qk_norm": "rms"}
size = {"model_dims": 32, "hidden_dims": 32, "num_heads": 2, "use_bias": False, "ff_activation": "relu"}
transformer = TransformerConfig(**size, **rms, use_rope_seq=True, use_rope_var=False, deterministic=True)
model = TimesFM3Torch(
    residual_block_config=ResidualBlockConfig(32, 32, use_bias=False, activation="relu"),
    transformer_config=StackedTransformersConfig(num_layers=2, transformer=transformer),
)
model.pre_transformer_resblock.set_input_dims(2 * (32 + 64))
model.save_pretrained(sys.argv[1])
forecaster = TimesFM3Forecaster.from_pretrained(sys.argv[1], device="cpu", local_files_only=True)
noise = np.random.default_rng(0).standard_normal(280).astype(np.float32)
room = (21 + 1.5 * np.sin(2 * np.pi * np.arange(256) / 24) + 0.1 * noise[:256]).astype(np.float32)


def first(contexts, **more):
    return next(iter(forecaster.predict_batch(contexts, 24, return_quantiles=True, **more))).quantiles


alone = first([room])
beside = {
    "a series 3 K warmer": first([room, room + 3]),
    "one twice as long": first([room, np.concatenate([room, room])]),
    "one with covariates": first([room, room], past_future_covariates=[None, noise[None]]),
}
moved = {name: float(np.abs(answer - alone).max()) for name, answer in beside.items()}
for name, value in moved.items():
    print(f"beside {name}: the forecast moves by {value:.6f} K")
assert moved["a series 3 K warmer"] < 1e-4 and moved["one twice as long"] < 1e-4
assert moved["one with covariates"] > 0.1
EOF
