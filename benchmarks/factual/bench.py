"""`tf-mpc bench factual`: the paper's factual tables and figures for measured homes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.factual.homes import Home, hashes
from benchmarks.factual.protocol import QUICK, Protocol
from benchmarks.factual.suite import run_suite
from benchmarks.free_response.scales import SCALES
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.execution import Engine

_MOST_S, _ROOMS = 300.0, 9


def run_factual_bench(
    homes: Sequence[Home],
    out: Path,
    *,
    first: pd.Timestamp | None = None,
    last: pd.Timestamp | None = None,
    days: Sequence[int] = (),
    backbone: str = "shipped",
    others: Sequence[str] = SCALES,
    quick: bool = False,
    engine: Engine,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Score every method on every home; write `factual.json`, tables as CSV, figures and `index.html` into `out`.

    A home's scores are kept under `out/homes`; a later call with the same settings and data goes on from there.

    Args:
        homes: measured homes.
        out: folder of the results, created if missing.
        first, last: stretch of the records; by default all, of which the protocol takes the first part.
        days: identification budgets, by default those of the paper (quick: 3).
        backbone: weights of the forecaster.
        others: backbones of their table.
        quick: one budget and fewer origins.
        engine: where homes are scored.
        progress: callback for progress lines.

    Raises:
        BackboneError: the forecaster's weights cannot be loaded.
        DataError: no home can be scored.
    """
    from benchmarks.factual import plots, tables
    from benchmarks.interventions.page import write_page
    from benchmarks.interventions.plots import save
    from thermoforce_mpc.files import write_json

    began = time.perf_counter()
    protocol = QUICK if quick else Protocol()
    if days:
        protocol = replace(protocol, days=tuple(sorted(set(days))))
    homes = [home.between(first, last) for home in homes]
    scores, left_out, _ = run_suite(
        homes, protocol, out / "homes", backbone=backbone, others=others, engine=engine, say=progress
    )
    found = {
        "main": tables.main_rows(scores, protocol),
        "covariates": tables.covariate_rows(scores, protocol),
        "few_shot": tables.few_shot_rows(scores, protocol),
        "backbones": tables.backbone_rows(scores),
        "homes": tables.home_rows(scores, protocol),
    }
    goals = tables.targets(scores, protocol)
    seconds = time.perf_counter() - began
    width = max(1, engine.width)
    work = float(np.mean([s.about["seconds"] for s in scores])) * _ROOMS / width
    goals.append(Target(f"seconds for {_ROOMS} homes on {width} processes", work, _MOST_S))
    result = results_json("factual", [row for rows in found.values() for row in rows], goals)
    result["manifest"] = {
        "protocol": protocol.to_json(),
        "backbone": backbone,
        "window": {"from": None if first is None else str(first), "until": None if last is None else str(last)},
        "data": hashes(homes),
        "homes": {s.home: s.about for s in scores},
        "left_out": left_out,
        "seconds": seconds,
    }
    plots.write_tables(out, found)
    figures = {"few-shot": save(plots.few_shot_figure(scores, protocol), out, "few_shot")}
    shown = plots.window_of(scores)
    if shown is None:
        progress("no home has an operator that lowers its validation error: no decomposition and no fan to draw")
    else:
        plots.write_tables(out, plots.window_tables(shown))
        figures["decomposition"] = save(plots.decomposition_figure(shown), out, "decomposition")
        figures["fan"] = save(plots.fan_figure(shown), out, "fan")
    write_json(out / "factual.json", result)
    write_page(out / "index.html", result, figures)
    progress(f"tables, figures, JSON and page: {out / 'index.html'}")
    return result
