"""`tf-mpc bench forecasters`: what foundation models do with constant, gapped, short, long, moved or mirrored series.

Through the adapters of this package, with weights that ship, else with random ones of the real architecture: they say
what the operations do, nothing of accuracy. Each model runs in a process of its own, on one thread.
"""

from __future__ import annotations

import json
import logging
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.free_response.random_models import MAKERS
from thermoforce_mpc.comparison.outcome import results_json
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones import known
from thermoforce_mpc.model.free_response.backbones.base import Backbone, Context, frozen_pass
from thermoforce_mpc.model.free_response.backbones.loading import load_backbone

NAMES = ("shipped", "shipped_weather", "fracast", *MAKERS)
HOURS, AHEAD = 512, 24
# Two forecasts are the same up to this share of the series' spread: single precision through dozens of layers.
SAME = 3e-3
# Longest history that is read, as the packages, or the names of the weights, say; of the others only the weights know.
CONTEXT = {
    **{"shipped": 512, "shipped_weather": 512, "chronos-bolt-small": 2048, "chronos-2": 8192, "timesfm": 16384},
    **{"timesfm-3": 15360, "ttm": 512, "flowstate": 2048},
}
_FEW = (1, 2, 4, 8, 16)
_OF_NAME = {model.name: model for model in known.KNOWN}


def series(hours: int = HOURS, seed: int = 0) -> Array:
    """Hourly temperatures near 21 °C with a wave of a day, a drift and noise, (hours,)."""
    noise = np.random.default_rng(seed).standard_normal(hours)
    t = np.arange(hours)
    return np.asarray(21.0 + 1.5 * np.sin(2 * np.pi * t / 24.0) + 0.3 * np.sin(t / 60.0) + 0.1 * noise)


def answers(backbone: Backbone) -> dict[str, Any]:
    """What a backbone does, a figure each; distances as shares of the series' standard deviation."""
    base = series()
    spread = float(base.std())

    def ask(free_C: Array, ahead: int = AHEAD) -> Array:
        """Quantiles (9, ahead), as the adapter gives them. Weather is the same in the hours that are the same."""
        rng = np.random.default_rng(1)
        past, future = rng.standard_normal((5000, 4))[-free_C.size :], rng.standard_normal((1000, 4))[:ahead]
        with frozen_pass():
            return backbone.quantiles_C([Context(free_C, past, future)])[0]

    def apart(one: Array, other: Array, of: float = spread) -> float:
        return float(np.abs(one - other).max() / of)

    plain = ask(base)
    held = base.copy()
    held[-6:] = base[-7]
    gaps = {"half": base.copy(), "second": base.copy(), "last 6": base.copy()}
    gaps["half"][: HOURS // 2] = np.nan
    gaps["second"][1:-1:2] = np.nan
    gaps["last 6"][-6:] = np.nan
    gapped = {name: ask(values) for name, values in gaps.items()}
    fewest = next((n for n in _FEW if _answered(ask, base, n)), None)
    level, zero = ask(np.full(HOURS, 21.0)), ask(np.zeros(HOURS))
    spike = base.copy()
    spike[-100] += 30.0
    longer = np.concatenate([series(4096 - HOURS, seed=1), base])
    crossing = np.diff(plain, axis=0) < -1e-6
    return {
        "shift": apart(ask(base + 30.0) - 30.0, plain),
        "scale": apart((ask(21.0 + 10.0 * (base - 21.0)) - 21.0) / 10.0 + 21.0, plain),
        "mirror": apart(-ask(-base)[::-1], plain),
        "horizon_48": apart(ask(base, 48)[:, :AHEAD], plain),
        "horizon_400": apart(ask(base, 400)[:, :AHEAD], plain),
        "crossing_share": float(crossing.any(axis=0).mean()),
        "constant_off_K": float(np.abs(level - 21.0).max()),
        "constant_zero_off_K": float(np.abs(zero).max()),
        "finite": all(np.isfinite(values).all() for values in (*gapped.values(), level, zero)),
        "fewest_values": fewest,
        "gap_at_the_end_as_held": apart(gapped["last 6"], ask(held)),
        "gap_of_half_as_short": apart(gapped["half"], ask(base[HOURS // 2 :])),
        "gap_every_second_as_a_line": apart(gapped["second"], ask(_bridged(gaps["second"]))),
        "older_values": apart(ask(longer), plain),
        "spike_K": float(np.abs(ask(spike)[4] - plain[4]).max()),
    }


def _answered(ask: Callable[[Array], Array], base: Array, known: int) -> bool:
    """Whether the last `known` values of `base` are enough: no error, and finite quantiles."""
    few = np.full(base.size, np.nan)
    few[-known:] = base[-known:]
    try:
        return bool(np.isfinite(ask(few)).all())
    except Exception:  # the libraries raise many types
        return False


def _bridged(values: Array) -> Array:
    known_at = np.flatnonzero(np.isfinite(values))
    return np.asarray(np.interp(np.arange(values.size), known_at, values[known_at]))


def one(name: str) -> dict[str, Any]:
    """The row of one model: parameters, time and memory of a forecast here, and `answers`."""
    with tempfile.TemporaryDirectory() as folder:
        if name in MAKERS:
            import torch

            torch.manual_seed(0)
            MAKERS[name](Path(folder), False)
        backbone = load_backbone(folder if name in MAKERS else name)
        free = series()
        context = Context(free, np.zeros((HOURS, 4)), np.zeros((AHEAD, 4)))
        took = []
        with frozen_pass():
            for _ in range(3):
                began = time.process_time()
                backbone.quantiles_C([context])
                took.append(time.process_time() - began)
        size = sum(value.numel() for module in backbone.modules for value in module.parameters())
        graph = getattr(backbone, "graph", None)
        return {
            "backbone": name,
            "weights": "random" if name in MAKERS else "its own",
            "licence": _OF_NAME[name].licence,
            "weather": "read" if _OF_NAME[name].covariates == known.WEATHER else "no",
            "context": CONTEXT.get(name),
            "parameters_M": (graph.parameters if graph is not None else size) / 1e6,
            "ms": 1e3 * min(took[1:]),
            "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
            **(figures := answers(backbone)),
            **in_words(figures),
        }


def in_words(figures: Mapping[str, Any]) -> dict[str, str]:
    """What the table says of `answers`."""

    def same(*names: str) -> bool:
        return max(figures[name] for name in names) < SAME

    off_K = max(figures["constant_off_K"], figures["constant_zero_off_K"])
    return {
        "moved or scaled": "same" if same("shift", "scale") else "other",
        "mirrored": "same" if same("mirror") else "other",
        "first day of two": "same" if same("horizon_48", "horizon_400") else "other",
        "constant": "the constant" if off_K < 1e-3 else f"{off_K:.2f} K off",
        "gaps": "a line, held" if same("gap_every_second_as_a_line", "gap_at_the_end_as_held") else "told",
        "cross": f"{figures['crossing_share']:.0%}",
    }


def run_forecasters_bench(
    names: Sequence[str] = (), progress: Callable[[str], None] = lambda _line: None
) -> dict[str, Any]:
    """Rows of the models of `names`, by default of all whose packages are installed, each from a process of its own.

    Raises `BackboneError` for a name that is not among `NAMES`, and where a model cannot be built or run.
    """
    if unknown := sorted(set(names) - set(NAMES)):
        raise BackboneError(f"{', '.join(unknown)}: not among {', '.join(NAMES)}")
    rows: list[dict[str, Any]] = []
    for name in names or [name for name in NAMES if not _missing(name)]:
        command = [sys.executable, "-W", "ignore", "-m", "benchmarks.free_response.forecasters", name]
        ran = subprocess.run(command, check=False, capture_output=True, text=True)
        if ran.returncode:
            raise BackboneError(f"{name}: {(ran.stderr.strip().splitlines() or ['ended without a word'])[-1]}")
        rows.append(json.loads(ran.stdout.splitlines()[-1]))
        progress(f"{name}: {rows[-1]['ms']:.0f} ms")
    return results_json("forecasters", rows, [])


def _missing(name: str) -> str:
    model = _OF_NAME[name]
    return known.Known(model.name, "", "", "", module=model.module, extra=model.extra).missing()


if __name__ == "__main__":
    logging.disable(logging.WARNING)
    # The limits on Python and torch are of the packages' installation; whether they run here is seen.
    known.Known.check = lambda self: None  # type: ignore[method-assign]
    print(json.dumps(one(sys.argv[1])))
