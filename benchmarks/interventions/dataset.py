"""Paired data of the suite: simulated once, stored on disk with SHA-256 hashes, and read back unchanged."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.interventions.pool import engine_hash, simulate_all
from benchmarks.interventions.protocol import (
    WARMUP_DAYS,
    WINDOW_START_H,
    Part,
    Protocol,
    WindowName,
    days_of,
    probing_shift,
    seconds,
    shift_of,
)
from thermoforce_mpc.data import DAY_S, HOUR_S, SIGNALS, Boundary, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.plants.energyplus.engine import engine_version, file_hash, weather_file
from thermoforce_mpc.plants.energyplus.zone import (
    CLIMATES,
    Climate,
    ClimateName,
    ZoneJob,
    base_setpoint,
    gains,
    zone_model,
)

# Days dropped at the start of the warm-up; the rest of it is the context of the forecasters.
_FORGOTTEN_DAYS = 4
_FORMAT = 2


@dataclass(frozen=True)
class Window:
    """One paired intervention: history before its start, and both runs over the horizon (N steps each)."""

    climate: ClimateName
    name: WindowName
    part: Part
    day: int
    shift_K: float
    history: Record
    factual: Record
    perturbed: Record

    @property
    def boundary(self) -> Boundary:
        """Weather of the horizon, the same for both runs; comfort, price and emissions are not used."""
        return Boundary.measured(self.factual)


@dataclass(frozen=True)
class Probe:
    """K probe days: history before them, and the pair of runs (probed, plain operation) from the same state."""

    history: Record
    pair: Pair


@dataclass(frozen=True)
class ClimateData:
    """Data of one climate: windows of both parts, and the probe for each number of days."""

    climate: Climate
    windows: tuple[Window, ...]
    probes: dict[int, Probe]

    def part(self, part: Part) -> list[Window]:
        """Windows of one part."""
        return [w for w in self.windows if w.part == part]


@dataclass(frozen=True)
class Dataset:
    """Data of the suite and the manifest of their inputs."""

    climates: dict[ClimateName, ClimateData]
    manifest: dict[str, Any]


def load_or_simulate(
    protocol: Protocol,
    folder: Path,
    engine: Engine | None = None,
    *,
    say: Callable[[str], None] = lambda line: None,
) -> Dataset:
    """Read the data of `protocol` from `folder`, or simulate (on `engine`) and store them there if they are missing.

    Raises:
        DataError: stored data are damaged or do not match their hash, or a pair differs before its window.
        PlantError: the engine is missing or failed.
    """
    made_from = _made_from(protocol)
    key = hashlib.sha256(json.dumps(made_from, sort_keys=True).encode()).hexdigest()[:16]
    arrays_file, manifest_file = folder / f"interventions-{key}.npz", folder / f"interventions-{key}.json"
    if not manifest_file.is_file():
        if engine is None:
            raise DataError(f"{manifest_file}: these pairs were not simulated yet, and no engine was given to do it")
        jobs, plan = _jobs(protocol)
        say(f"EnergyPlus: {len(jobs)} simulations")
        step = max(1, len(jobs) // 20)

        def progress(done: int) -> None:
            if done % step == 0 or done == len(jobs):
                say(f"EnergyPlus: {done} of {len(jobs)} simulations")

        records = simulate_all(jobs, engine, on_done=progress)
        arrays = {
            f"{label}/{signal}": getattr(record, signal)
            for label, record in _cut(plan, records).items()
            for signal in SIGNALS
        }
        folder.mkdir(parents=True, exist_ok=True)
        partial = arrays_file.with_suffix(f".{os.getpid()}.npz")
        np.savez_compressed(partial, allow_pickle=False, **arrays)
        partial.replace(arrays_file)
        manifest = made_from | {"arrays": arrays_file.name, "arrays_sha256": _arrays_hash(arrays)}
        manifest_file.write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n")
    return _read(protocol, arrays_file, manifest_file)


def _made_from(protocol: Protocol) -> dict[str, Any]:
    """All inputs that determine the data: format, engine, protocol, weather, model."""
    climates = {}
    for name in protocol.climates:
        climate = CLIMATES[name]
        weather = weather_file(climate.spec.weather)
        model = json.dumps(zone_model(climate.spec, climate.first_day, WARMUP_DAYS), sort_keys=True)
        climates[name] = asdict(climate) | {
            "weather_file": weather.name,
            "weather_sha256": file_hash(weather),
            "model_sha256": hashlib.sha256(model.encode()).hexdigest(),
        }
    return {
        "format": _FORMAT,
        "engine": engine_version(),
        "engine_sha256": engine_hash(),
        "protocol": asdict(protocol),
        "climates": climates,
    }


@dataclass(frozen=True)
class _Cut:
    """Steps `start` to `stop` of run number `run`, stored as the record `label`."""

    label: str
    run: int
    start: int
    stop: int
    # The run that must be bit-identical to this one up to `start`.
    twin: int | None = None


def _jobs(protocol: Protocol) -> tuple[list[ZoneJob], list[_Cut]]:
    jobs: list[ZoneJob] = []
    plan: list[_Cut] = []
    for name in protocol.climates:
        climate = CLIMATES[name]
        per_hour = HOUR_S / climate.spec.step_s
        forgotten = round(_FORGOTTEN_DAYS * 24 * per_hour)

        def job(first_day: int, n_days: int, climate: Climate = climate) -> ZoneJob:
            start = first_day - WARMUP_DAYS
            setpoint = base_setpoint(climate, WARMUP_DAYS + n_days)
            return ZoneJob(climate.spec, start, setpoint, gains(climate, start, WARMUP_DAYS + n_days, protocol.seed))

        warm = round(WARMUP_DAYS * 24 * per_hour)
        for k in protocol.probe_days:
            factual = job(climate.first_day + protocol.probe_part_days - k, k)
            probed = factual.setpoint_C.copy()
            probed[warm:] += probing_shift(climate, k, protocol.seed)
            base = len(jobs)
            jobs += [factual, ZoneJob(climate.spec, factual.first_day, probed, factual.gains)]
            plan.append(_Cut(f"{name}/probe/{k}/history", base, forgotten, warm))
            plan.append(_Cut(f"{name}/probe/{k}/factual", base, warm, factual.n_steps))
            plan.append(_Cut(f"{name}/probe/{k}/probed", base + 1, warm, factual.n_steps, twin=base))
        for part in ("validation", "test"):
            for index, day in enumerate(days_of(protocol, climate, part)):
                factual = job(day, 1)
                base = len(jobs)
                jobs.append(factual)
                for position, (window, hour) in enumerate(WINDOW_START_H.items()):
                    start = warm + round(hour * per_hour)
                    end = start + round(protocol.horizon_h * per_hour)
                    setpoint = factual.setpoint_C.copy()
                    setpoint[start : start + round(protocol.shift_h * per_hour)] += shift_of(index, position)
                    label = f"{name}/{part}/{day}/{window}"
                    plan.append(_Cut(f"{label}/history", base, forgotten, start))
                    plan.append(_Cut(f"{label}/factual", base, start, end))
                    plan.append(_Cut(f"{label}/perturbed", len(jobs), start, end, twin=base))
                    jobs.append(ZoneJob(climate.spec, factual.first_day, setpoint, factual.gains))
    return jobs, plan


def check_identical(a: Record, b: Record, n_steps: int, what: str) -> None:
    """Check that two runs are bit-identical in the `n_steps` steps before the intervention.

    Raises:
        DataError: naming the signal and the first step that differs.
    """
    first, second = a.slice(0, n_steps), b.slice(0, n_steps)
    for signal in SIGNALS:
        x, y = getattr(first, signal), getattr(second, signal)
        if x.shape != y.shape or x.tobytes() != y.tobytes():
            at = int(np.flatnonzero(x != y)[0]) if x.shape == y.shape and (x != y).any() else min(x.size, y.size)
            raise DataError(f"{what}: {signal} differs at step {at}, before the intervention at step {n_steps}")


def _cut(plan: list[_Cut], records: list[Record]) -> dict[str, Record]:
    out = {}
    for item in plan:
        if item.twin is not None:
            check_identical(records[item.run], records[item.twin], item.start, item.label)
        out[item.label] = records[item.run].slice(item.start, item.stop)
    return out


def _arrays_hash(arrays: dict[str, Any]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(arrays[name], dtype=np.float64).tobytes())
    return digest.hexdigest()


def _read(protocol: Protocol, arrays_file: Path, manifest_file: Path) -> Dataset:
    advice = "delete both files and simulate again"
    try:
        manifest = json.loads(manifest_file.read_text())
        with np.load(arrays_file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError) as error:
        raise DataError(f"{manifest_file} or {arrays_file.name} cannot be read ({error}); {advice}") from error
    if _arrays_hash(arrays) != manifest["arrays_sha256"]:
        raise DataError(f"{arrays_file}: the numbers do not match the hash in {manifest_file.name}; {advice}")

    def record(label: str) -> Record:
        # Data of earlier versions hold no return temperature.
        kept = [signal for signal in SIGNALS if f"{label}/{signal}" in arrays]
        return Record(**{name: arrays[f"{label}/{name}"] for name in kept})

    climates = {}
    for name in protocol.climates:
        climate = CLIMATES[name]
        windows = []
        for part in ("validation", "test"):
            for index, day in enumerate(days_of(protocol, climate, part)):
                for position, (window, hour) in enumerate(WINDOW_START_H.items()):
                    label = f"{name}/{part}/{day}/{window}"
                    past, factual, perturbed = (record(f"{label}/{x}") for x in ("history", "factual", "perturbed"))
                    if factual.time_s[0] != seconds(day, hour):
                        raise DataError(f"{arrays_file}: {label} does not begin at day {day}, {hour:g} h; {advice}")
                    shift = shift_of(index, position)
                    windows.append(Window(name, window, part, day, shift, past, factual, perturbed))
        probes = {}
        for k in protocol.probe_days:
            past, plain, probed = (record(f"{name}/probe/{k}/{x}") for x in ("history", "factual", "probed"))
            start = plain.time_s[0] / DAY_S
            probes[k] = Probe(past, Pair(probed, plain, label=f"{k} days from day {start:g}"))
        climates[name] = ClimateData(climate, tuple(windows), probes)
    return Dataset(climates, manifest)
