#!/usr/bin/env bash
# granite-tsfm: a Tiny Time Mixer's forecast depends on what stands where past_observed_mask says that nothing was observed.
#
# Versions: granite-tsfm 0.3.11, torch 2.11.0, transformers 5.24.0
# A good guess: values under a mask of False change nothing (the documentation: the mask marks "missing values that were
# replaced with zeros"), and a context shorter than the model's may be given without a mask
# Seen: 0 in place of the values under the mask moves the forecast by kelvins, 10,000 by thousands, NaN gives NaN: the mask
# is used for mean and spread alone. A short context is filled with zeros, which without a mask are data: 0 °C
# Why it matters: a gap in a room's temperature, filled with zeros as the documentation says, is a room at 0 °C for an hour;
# fill it by a line before the mask is given
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile granite-tsfm==0.3.11 torch==2.11.0 transformers==5.24.0
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import torch
from tsfm_public.models.tinytimemixer import TinyTimeMixerConfig, TinyTimeMixerForPrediction

torch.manual_seed(0)
sizes = {"context_length": 128, "patch_length": 16, "patch_stride": 16, "d_model": 16, "num_layers": 1}
config = TinyTimeMixerConfig(**sizes, decoder_num_layers=1, prediction_length=24, multi_quantile_head=True)
model = TinyTimeMixerForPrediction(config).eval()
hours = torch.arange(128.0)
room = (21.0 + 1.5 * torch.sin(2 * torch.pi * hours / 24.0))[None, :, None]
seen = torch.ones_like(room, dtype=torch.bool)
seen[:, 40:60] = False


def forecast(values, mask=seen):
    with torch.inference_mode():
        answer = model(past_values=values, past_observed_mask=mask, return_loss=False)
    return answer.quantile_outputs[0, :, :, 0].numpy()


def hidden(value):
    return torch.where(seen, room, torch.tensor(value))


def apart(one, other):
    return float(np.abs(one - other).max())


zero, large = apart(forecast(hidden(0.0)), forecast(room)), apart(forecast(hidden(1e4)), forecast(room))
print(f"under the mask: 0 moves the forecast by {zero:.2f} K, 10,000 by {large:.0f} K")
print("under the mask: NaN gives finite quantiles:", bool(np.isfinite(forecast(hidden(float("nan")))).all()))
short = apart(forecast(room[:, -100:], None), forecast(room, torch.ones_like(seen)))
print(f"100 of 128 values, without a mask: {short:.1f} K from the forecast of all 128")
assert zero > 0.5 and large > 100 * zero and short > 5.0
assert not np.isfinite(forecast(hidden(float("nan")))).all()
EOF
