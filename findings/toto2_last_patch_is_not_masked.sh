#!/usr/bin/env bash
# toto-2: target_mask is ignored in the last patch of the context, so values that were never measured are forecast from.
#
# Versions: toto-2 2.0.0, torch 2.13.0, Python 3.12
# A good guess: what stands where target_mask is False changes nothing, with has_missing_values=True, anywhere
# Seen: it changes nothing in any patch but the last. There 0 or 100 in place of a room's 21 °C moves the forecast by more
# than a kelvin, and the forecast with the mask is that without it
# Why it matters: a sensor is late or silent now, not last week; zeros under the mask of the last hours are a room at 0 °C.
# Hold the last value there
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3.12 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile toto-2==2.0.0 torch==2.13.0
"$work/venv/bin/python" -W ignore - <<'EOF'
import torch
from toto2 import Toto2Model, Toto2ModelConfig

torch.manual_seed(0)
sizes = {"patch_size": 16, "d_model": 32, "num_heads": 2, "num_layers": 2, "layer_group_size": 2}
order = {"num_variate_layers_per_group": 1, "variate_layer_first": False, "residual_attn_ratio": 2.0}
model = Toto2Model(Toto2ModelConfig(**sizes, **order)).eval()
hours = torch.arange(256.0)
room = 21.0 + 1.5 * torch.sin(2 * torch.pi * hours / 24.0)


def forecast(values, seen):
    inputs = {
        "target": values[None, None],
        "target_mask": seen[None, None],
        "series_ids": torch.zeros(1, 1, dtype=torch.long),
    }
    with torch.inference_mode():
        return model.forecast(inputs, horizon=24, has_missing_values=True)


moved = {}
for where, hidden in (("an earlier patch", slice(100, 106)), ("the last patch", slice(-6, None))):
    seen = torch.ones(256, dtype=torch.bool)
    seen[hidden] = False
    for value in (0.0, 100.0):
        other = torch.where(seen, room, torch.tensor(value))
        moved[where, value] = float((forecast(other, seen) - forecast(room, seen)).abs().max())
        print(f"{value:g} under the mask of {where}: the forecast moves by {moved[where, value]:.3f} K")
everything = torch.ones(256, dtype=torch.bool)
print("with the last six masked, as with none:", bool((forecast(room, seen) == forecast(room, everything)).all()))
assert max(moved["an earlier patch", value] for value in (0.0, 100.0)) == 0.0
assert min(moved["the last patch", value] for value in (0.0, 100.0)) > 0.5
EOF
