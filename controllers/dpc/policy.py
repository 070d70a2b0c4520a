"""The policy: a small network from what is ahead of a zone to the level of its actuator, and its file.

Its inputs at step k, at lead times j of `LEADS_H`, with T_off the temperature if nothing acts from now on:

    (T_off − lower) / S_j,   (upper − T_off) / S_j   at k + j,   and the cost of heat at k + j over its mean − 1,

each between −2.5 and 2.5, where S_j is the effect of full level from k to k + j: −(T_off − lower) / S_j is the level
that, held, meets the bound. The temperatures are given once more on one scale for all leads, eight hours at full level.
To what the network says, in logits, is added what the greatest of these levels says. All of the building's memory is in
T_off, so that the same inputs call for the same action.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.errors import ArtifactError
from thermoforce_mpc.files import check_replaceable, parse_json, read_bounded, storage_errors, write_whole
from thermoforce_mpc.model.operator.features import OUTDOOR
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.saved.model_file import content_sha256
from thermoforce_mpc.version import VERSION

LEADS_H = (0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24)
N_INPUTS = 5 * len(LEADS_H)
MOST = 2.5
# Scale of the coarse inputs, h at full level; logits per level that a bound asks for, zero at half.
_COARSE_H, STEEP = 8.0, 6.0

FORMAT, FORMAT_VERSION = "thermoforce-mpc policy", 1
JSON_NAME, ARRAYS_NAME = "policy.json", "weights.safetensors"
_LAYERS = ("weight_1", "bias_1", "weight_2", "bias_2", "weight_3", "bias_3")
_MOST_BYTES = 50_000_000


def lead_steps(step_s: float) -> Array:
    """Lead times in steps (J,), at least one."""
    return np.maximum(np.round(np.array(LEADS_H) * HOUR_S / step_s), 1).astype(np.int64)


def scales_K(operator: OperatorParameters) -> tuple[Array, float]:
    """S_j (J,), and the coarse scale, K, positive."""

    def effect_K(steps: Array) -> Array:
        response = (1.0 - operator.poles ** steps[:, None]) / (1.0 - operator.poles)
        return np.maximum(np.abs((operator.gains * response).sum(axis=1)), 1e-6)

    coarse = np.array([max(1.0, round(_COARSE_H * HOUR_S / operator.step_s))])
    return effect_K(lead_steps(operator.step_s)), float(effect_K(coarse)[0])


def operator_sha256(operator: OperatorParameters) -> str:
    """Hash of what a policy knows of an operator: poles, gains, step and sign."""
    values = np.concatenate([operator.poles, operator.gains, [operator.step_s, operator.sign]])
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


@dataclass(frozen=True, eq=False)
class Policy:
    """Weights of the network (hidden, inputs), (hidden,), (hidden, hidden), (hidden,), (1, hidden), (1,).

    Its output goes to level `highest`; up to level `lowest` the machine switches. `operator_sha256`: the operator that
    it was trained for, at `step_s`; `loss`: mean cost of the last tenth of its `iterations`, 1: full level.
    """

    weights: tuple[Array, ...]
    highest: float
    lowest: float
    step_s: float
    operator_sha256: str
    iterations: int
    loss: float

    def levels(
        self, F0: Array, operator: OperatorParameters, drive: tuple[Array, Array], ahead: Array, relative: Array
    ) -> Array:
        """Levels (N,) of the policy in closed loop with the operator, in [0, `highest`].

        Args:
            F0: forced state now (r,), K.
            operator: of the zone, at the policy's step.
            drive: drive of each step while on, per share of on-time and per level (N,); see `drive_parts`.
            ahead: rows T_free, lower and upper at the end of each step (3, N + J), °C; J is the largest lead time.
            relative: cost of heat of each step (N + J,), any unit.
        """
        (fixed, per_u), (step_K, coarse_K) = drive, scales_K(operator)
        return np.asarray(
            _levels(
                np.ascontiguousarray(F0), operator.poles, operator.gains, fixed, per_u, ahead, relative,
                lead_steps(self.step_s), float(operator.sign), self.highest, self.lowest, step_K, coarse_K,
                *self.weights,
            )
        )  # fmt: skip

    def save(self, folder: Path, *, overwrite: bool = False) -> Path:
        """Write the policy to `folder`; the same policy gives the same bytes.

        Raises:
            ArtifactError: `folder` exists, unless `overwrite` and it holds a policy.
            StorageError: it cannot be written.
        """
        check_target(folder, overwrite=overwrite)
        raw = save_tensors({name: np.ascontiguousarray(w) for name, w in zip(_LAYERS, self.weights, strict=True)})
        document: dict[str, Any] = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "code_version": VERSION,
            "leads_h": list(map(float, LEADS_H)),
            "weights_sha256": hashlib.sha256(raw).hexdigest(),
        }
        document |= {name: getattr(self, name) for name in _FIELDS}
        text = json.dumps(document | {"sha256": content_sha256(document)}, indent=2, allow_nan=False) + "\n"
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / ARRAYS_NAME, raw)
        write_whole(folder / JSON_NAME, text)
        return folder


_FIELDS = ("highest", "lowest", "step_s", "operator_sha256", "iterations", "loss")


def check_target(folder: Path, *, overwrite: bool) -> None:
    """Check that a policy may be written to `folder`.

    Raises:
        ArtifactError: `folder` exists, unless `overwrite` and it holds a policy.
    """
    check_replaceable(folder, JSON_NAME, "policy", overwrite=overwrite)


def load_policy(folder: Path) -> Policy:
    """Read a saved policy.

    Raises:
        ArtifactError: a file is missing, damaged, foreign, edited or of another version; names it.
    """
    path = folder / JSON_NAME
    if not folder.is_dir():
        raise ArtifactError(f"{folder}: no such folder; `tf-mpc train` makes one")
    document = parse_json(read_bounded(path, _MOST_BYTES, ArtifactError), str(path), ArtifactError)
    if document.get("format") != FORMAT or document.get("version") != FORMAT_VERSION:
        raise ArtifactError(f"{path}: not a policy of version {FORMAT_VERSION} of thermoforce-mpc; train it again")
    if content_sha256(document) != document.get("sha256") or document.get("leads_h") != list(map(float, LEADS_H)):
        raise ArtifactError(f"{path}: damaged or edited; train it again")
    raw = read_bounded(folder / ARRAYS_NAME, _MOST_BYTES, ArtifactError)
    if hashlib.sha256(raw).hexdigest() != document.get("weights_sha256"):
        raise ArtifactError(f"{folder / ARRAYS_NAME}: damaged or swapped, its sha256 is not the one in {JSON_NAME}")
    try:
        arrays = load_tensors(raw)
        policy = Policy(tuple(arrays[name] for name in _LAYERS), **{name: document[name] for name in _FIELDS})
        h = policy.weights[0].shape[0]
        shapes = [(h, N_INPUTS), (h,), (h, h), (h,), (1, h), (1,)]
        if [w.shape for w in policy.weights] != shapes or not all(np.isfinite(w).all() for w in policy.weights):
            raise ValueError("its layers do not fit together")
        if not (0.0 < policy.highest <= 1.0 and 0.0 < policy.lowest <= 1.0 and policy.step_s > 0.0):
            raise ValueError(f"levels {policy.lowest!r} to {policy.highest!r}, step {policy.step_s!r} s")
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise ArtifactError(f"{folder}: not a usable policy ({error})") from error
    return policy


def drive_parts(operator: OperatorParameters, features: Array) -> tuple[Array, Array]:
    """Drive of each step per share of on-time and per level (...): m(x)·v(u) = on · first + u · second.

    `features` (..., 4): x_t of each step.
    """
    highest = operator.drive(np.ones(features.shape[:-1]), features)
    load = operator.heat_input.heat
    if load is None:
        return np.zeros_like(highest), np.asarray(highest)
    fixed, per_u = load.parts(features[..., OUTDOOR])
    full = fixed + per_u
    return np.asarray(highest * fixed / full), np.asarray(highest * per_u / full)


@njit(cache=True)
def _levels(
    F0: Array, poles: Array, gains: Array, fixed: Array, per_u: Array, ahead: Array, relative: Array, leads: Array,
    sign: float, highest: float, lowest: float, step_K: Array, coarse_K: float,
    w1: Array, b1: Array, w2: Array, b2: Array, w3: Array, b3: Array,
) -> Array:  # fmt: skip
    """Policy in closed loop, with a machine that runs for the share u / lowest of a step."""
    n, J, r = fixed.size, leads.size, poles.size
    F, out, x = F0.copy(), np.empty(n), np.empty(5 * J)
    fading = np.empty((J, r))
    for j in range(J):
        for i in range(r):
            fading[j, i] = poles[i] ** leads[j]
    for k in range(n):
        mean, need = 0.0, -np.inf
        for j in range(J):
            at = k + leads[j] - 1  # rows hold the ends of steps
            off = ahead[0, at]
            for i in range(r):
                off += fading[j, i] * F[i]
            below, above = off - ahead[1, at], ahead[2, at] - off
            if sign < 0.0:
                below, above = above, below
            x[j] = min(max(below / step_K[j], -MOST), MOST)
            x[J + j] = min(max(above / step_K[j], -MOST), MOST)
            x[2 * J + j] = min(max(below / coarse_K, -MOST), MOST)
            x[3 * J + j] = min(max(above / coarse_K, -MOST), MOST)
            need = max(need, -x[j])
            mean += abs(relative[at]) / J
        for j in range(J):
            x[4 * J + j] = min(max(relative[k + leads[j] - 1] / max(mean, 1e-300) - 1.0, -MOST), MOST)
        first = np.tanh(w1 @ x + b1)
        second = np.tanh(w2 @ first + b2)
        logit = (w3 @ second + b3)[0] + STEEP * (need - 0.5)
        out[k] = highest / (1.0 + np.exp(-logit))
        drive = min(out[k] / lowest, 1.0) * fixed[k] + per_u[k] * out[k]
        for i in range(r):
            F[i] = poles[i] * F[i] + gains[i] * drive
    return out
