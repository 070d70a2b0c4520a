#!/usr/bin/env bash
# safetensors writes the memory of a numpy array, whatever its strides say: a transposed array comes back with other numbers.
#
# Versions: safetensors 0.8.0, numpy 2.4.6
# A good guess: `load(save({"a": a}))["a"]` equals a, or saving says that a is not contiguous, as it does for torch tensors
# Seen: a transposed array, one in Fortran order and one with a step (`a[::2]`) are saved and loaded without a word, with
# the right shape and other numbers; the torch half of the library refuses such tensors
# Why it matters: gains that came out of a least-squares routine in Fortran order are another building's after loading
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile safetensors==0.8.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from safetensors.numpy import load, save

rows = np.arange(6.0).reshape(2, 3)
for name, array in (("transposed", rows.T), ("Fortran order", np.asfortranarray(rows)), ("every second", np.arange(10.0)[::2])):
    back = load(save({"a": array}))["a"]
    print(f"{name}: saved {array.tolist()}, loaded {back.tolist()}")
    assert back.shape == array.shape and not np.array_equal(back, array)
assert np.array_equal(load(save({"a": np.ascontiguousarray(rows.T)}))["a"], rows.T)
EOF
