"""The suite over all homes: one task a home, each home's scores kept in a file so that a stopped run goes on."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.cases import run_all
from benchmarks.factual.evaluate import BEST, RAW, Evaluation, Scores
from benchmarks.factual.homes import Home, Prepared, prepared
from benchmarks.factual.protocol import Protocol
from benchmarks.free_response.scales import backbone_of
from thermoforce_mpc.comparison.cells import Inputs
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine, source_fingerprint
from thermoforce_mpc.files import write_json
from thermoforce_mpc.model.free_response.backbones.loading import SHIPPED, shipped_folder

Say = Callable[[str], None]

Task = tuple[Prepared, Protocol, str, tuple[str, ...]]


def evaluate_home(task: Task) -> Scores:
    """Scores of one prepared home; reproducible."""
    import torch

    torch.set_num_threads(1)  # fixed order of summation: reproducible results
    home, protocol, backbone, others = task
    return Evaluation(home, protocol, backbone, others).run()


def run_suite(
    homes: Sequence[Home],
    protocol: Protocol,
    folder: Path,
    *,
    backbone: str = "shipped",
    others: Sequence[str] = (),
    engine: Engine,
    evaluate: Callable[[Task], Scores] = evaluate_home,
    say: Say = lambda line: None,
) -> tuple[list[Scores], dict[str, str], int]:
    """Score every home; returns the scores, why homes were left out, and how many were computed in this call.

    Args:
        homes: as read.
        protocol: how they are cut and scored.
        folder: where each home's scores are kept; those of the same settings, data, weights and source code are read,
            not computed.
        backbone: weights of the forecaster.
        others: further backbones for their table.
        engine: where homes are scored; results do not depend on it.
        evaluate: scores one home.
        say: callback for progress lines.

    Raises:
        BackboneError: the forecaster's weights cannot be loaded.
        ConfigError: they cannot be read.
        DataError: no home can be scored; the message says why not.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left_out: dict[str, str] = {}
    found: dict[str, Scores] = {}
    tasks: list[Task] = []
    keys: dict[str, str] = {}
    weights = _weights((backbone, *others))
    for home in homes:
        try:
            ready = prepared(home, protocol)
        except DataError as error:
            left_out[home.name] = str(error)
            say(f"left out: {error}")
            continue
        keys[home.name] = _key(ready, protocol, weights)
        kept = _read(_file(folder, home.name), keys[home.name])
        if kept:
            found[home.name] = kept
            say(f"{home.name}: scores of an earlier run with the same settings and data")
        else:
            tasks.append((ready, protocol, backbone, tuple(others)))
    if not tasks and not found:
        raise DataError("no home can be scored: " + "; ".join(left_out.values()))
    done = 0

    def keep(scores: Scores) -> None:
        nonlocal done
        done += 1
        write_json(_file(folder, scores.home), {"key": keys[scores.home], "scores": asdict(scores)})
        found[scores.home] = scores
        raw, best = scores.errors[RAW]["0"], scores.errors[BEST][str(protocol.main_days)]
        told = ", ".join(f"{h} h {best[h]:.3f} K (raw {raw[h]:.3f})" for h in raw)
        say(f"{done} of {len(tasks)}: {scores.home}: {told}")

    run_all(evaluate, tasks, engine, lambda _, scores: keep(scores))
    return [found[home.name] for home in homes if home.name in found], left_out, len(tasks)


def _file(folder: Path, home: str) -> Path:
    return folder / f"{re.sub(r'[^A-Za-z0-9]+', '_', home)}.json"


def _weights(backbones: Sequence[str]) -> list[list[str]]:
    """The forecasters by name and, where their weights are in a folder, its content."""
    content = Inputs()
    folders = {name: shipped_folder() if name == SHIPPED else Path(backbone_of(name)) for name in backbones}
    return [[name, content(str(at)) if (at := folders[name]).expanduser().is_dir() else ""] for name in backbones]


def _key(home: Prepared, protocol: Protocol, weights: Sequence[Sequence[str]]) -> str:
    """Hash of everything that a home's scores depend on, the source code included."""
    settings = [protocol.to_json(), list(weights), source_fingerprint("benchmarks")]
    digest = hashlib.sha256(json.dumps(settings).encode())
    record = home.record
    for values in (record.time_s, home.truth_C, record.T_out_C, record.solar_W_m2, *home.levels.values(), home.usable):
        digest.update(values.tobytes())
    digest.update(json.dumps([list(home.levels), home.home.sign]).encode())
    return digest.hexdigest()


def _read(path: Path, key: str) -> Scores | None:
    """Kept scores with this key; None where there are none, or of other settings or data."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return Scores(**content["scores"]) if content["key"] == key else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
