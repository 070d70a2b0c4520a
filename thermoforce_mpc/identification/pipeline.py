"""From recorded runs of a building to its thermal model, zone by zone.

Refuse what cannot identify; fit heat and power to what was measured; estimate what each actuator does to its home zone
beside all others (`zones`); assemble the operator of the building. All steps are deterministic for a given seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from thermoforce_mpc.data import DAY_S, Layout, Record
from thermoforce_mpc.data.names import check_same_building
from thermoforce_mpc.errors import DataError, check_kind
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.confounding import unknown_heat
from thermoforce_mpc.identification.effects.couplings import (
    assembled,
    others_of,
    sizes_by_power,
    with_metered_shares,
    with_shares_by_power,
)
from thermoforce_mpc.identification.effects.meters import (
    OtherLoads,
    foreign_loads,
    identified_heat_input,
    power_of_machine,
)
from thermoforce_mpc.identification.estimation.records import (
    Pair,
    check_pairs,
    check_steps,
    data_hash,
    prepared_pairs,
    prepared_runs,
)
from thermoforce_mpc.identification.network.lag import rooms_in_time
from thermoforce_mpc.identification.network.sensor import without_sun
from thermoforce_mpc.identification.zones.data import Estimate, ZoneData
from thermoforce_mpc.identification.zones.model import identify_zone
from thermoforce_mpc.identification.zones.network_estimate import network_estimates
from thermoforce_mpc.identification.zones.two_stage import two_stage_estimate
from thermoforce_mpc.measurements.checks import Remark, remarks
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.screening import ReadingLimits
from thermoforce_mpc.model.thermal_model import ThermalModel


# Matrices are small: threads of BLAS wait for each other ten times as long as they compute.
@threadpool_limits.wrap(limits=1, user_api="blas")
def identify(
    runs: Record | Sequence[Record] = (),
    pairs: Sequence[Pair] = (),
    *,
    config: IdentificationConfig | None = None,
    layout: Layout | None = None,
    mode: Literal["heating", "cooling", "both"] = "heating",
    u_min: float = 0.0,
    floor_area_m2: float | None = None,
    step_s: float | None = None,
    source: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> ThermalModel:
    """Identify a thermal model.

    Args:
        runs: one recorded run or several, each with its own excitation, of about a day or longer.
        pairs: runs that share start and weather (paper eq:paired). All records have one step.
        config: options.
        layout: what acts where; by default one zone with one actuator, described by the next three.
        mode: sign of what the actuator does to the zone; both: levels are signed, cooling below 0.
        u_min: lowest level, below 0 with mode both.
        floor_area_m2: heated floor area, m²; with measured heat the network expects a building of this area. Readings
            of heat and power that no building of this area gives are left out.
        step_s: step of the returned operator, s; by default the step of the data.
        source: what the model card says the data are; by default the times of the records.
        progress: called with each stage in a few words, for example `print`.

    Returns:
        Operator, electric power (where measured), linear free model (where there are runs) and model cards. Their notes
        say which readings were rejected and how gaps were bridged or left out (`prepared_runs`), their `competence`
        whether the model is good enough to act on; one that is not is returned all the same.

    Raises:
        DataError: there are no data, they do not fit the layout, or they cannot be fitted at all; the message has the
            numbers and what to do.
    """
    config = config or IdentificationConfig()
    check_kind(config, IdentificationConfig, "config", "give IdentificationConfig(...)")
    check_kind(runs, (Record, Iterable), "runs", "give a record, or several")
    runs = (runs,) if isinstance(runs, Record) else tuple(runs)
    for one in runs:
        check_kind(one, Record, "runs: one of them", "Record.from_dataframe makes one of a table")
    source = source or _times_of([*runs, *(pair.a for pair in pairs)])
    say = progress or (lambda text: None)
    if (mode == "both") != (u_min < 0.0):
        raise DataError(f"mode is {mode} and the lowest level {u_min:g}: mode both needs one below 0, others 0")
    if not runs and not pairs:
        raise DataError("nothing to identify from: give at least one run or pair")
    if layout is not None:
        check_kind(layout, Layout, "layout", "give Layout(...), or that of read_measurements(...)")
    else:
        names = (runs[0] if runs else pairs[0].a).names
        if not names.single:
            raise DataError(f"the records have {names}: say what acts where (layout)")
        layout = replace(Layout.single(mode, u_min, floor_area_m2), names=names)
    records = _prepared(runs, pairs, layout, config)
    alone = len(layout.home) == 1
    inputs, noted = [], []
    for a, home in enumerate(layout.home):
        parts = [h.part(home, [a], [layout.machine_of[a]]) for h in records.histories]
        with _told(records, layout, a):
            heat_input, of_heat = identified_heat_input(parts, config, layout.signs[a], layout.u_min[a], alone)
        inputs.append(heat_input)
        noted.append([*records.notes, *of_heat, *records.foreign.notes(a)])
    runs, sun = without_sun(records.runs, layout, inputs, config)
    runs, pairs, late = rooms_in_time(runs, records.pairs, layout, inputs, config)
    data = []
    for a, home in enumerate(layout.home):
        m, order, likeliest = layout.machine_of[a], [a, *others_of(layout, a, config)], sun.get(home)
        taken_off = likeliest if likeliest is not None and likeliest.likely else None
        card = ModelCard(
            source,
            records.hashes,
            scores={} if likeliest is None else {"sun_on_sensor": likeliest.probability},
            config=config.model_dump(mode="json"),
            notes=(*noted[a], *(found.in_words() for found in (taken_off, late.get(home)) if found is not None)),
            sun_on_sensor=taken_off,
            late_sensor=late.get(home),
            foreign_heat=records.foreign.heat[a],
        )
        of_zone = [h.part(home, order, [m]) for h in runs]
        pairs_of_zone = [p.part(home, order, [m]) for p in pairs]
        bars = [remark for remark in records.doubts if a in remark.actuators]
        area_m2 = float(layout.floor_area_m2[home])
        sign = layout.signs[a]
        data.append(ZoneData(config, of_zone, pairs_of_zone, inputs[a], sign, step_s, card, alone, bars, area_m2))
    days = sum(h.n_steps * h.step_s for h in records.histories) / DAY_S
    say(f"fitting what acting does to {days:.3g} days of records")
    estimates = _estimates(runs, pairs, records, layout, data, config)
    layout = with_metered_shares(layout, [each.everything.heat_input for each in estimates], records.histories)
    layout = with_shares_by_power(layout, records.histories)
    power, of_power = _powers(records, config, layout)
    zones, heat_sd = [], []
    for a, (zone, estimate) in enumerate(zip(data, estimates, strict=True)):
        m = layout.machine_of[a]
        own = power[m] if len(layout.fed_by(m)) == 1 else None
        unknown = unknown_heat(runs, layout, a, inputs[a], estimate.laws, config)
        heat_sd.append(unknown.heat_sd)
        with _told(records, layout, a, say) as tell:
            zones.append(identify_zone(zone, estimate, own, unknown, of_power[m], tell))
    together_sd = [estimate.together_sd for estimate in estimates]
    return assembled(
        layout, zones, [estimate.effects[1:] for estimate in estimates], power, config, heat_sd, together_sd
    )


@dataclass(frozen=True)
class _Records:
    """Records that can be used: gaps bridged, other loads taken off the meters.

    `histories`: the runs, then those of the pairs; `foreign`: those other loads; `doubts`: what the runs say against
    themselves; `notes` on it and on gaps; `hashes` of the records as they came, by name.
    """

    runs: Sequence[Record]
    pairs: Sequence[Pair]
    histories: Sequence[Record]
    foreign: OtherLoads
    doubts: Sequence[Remark]
    notes: Sequence[str]
    hashes: Mapping[str, str]


def _prepared(runs: Sequence[Record], pairs: Sequence[Pair], layout: Layout, config: IdentificationConfig) -> _Records:
    """The records, checked.

    Raises:
        DataError: they do not fit the layout, or nothing usable is left of them.
    """
    given = _named(runs, pairs)
    for record in _histories(runs, pairs):
        check_same_building("the record", record.names, "the layout", layout.names)
    hashes = {name: data_hash(record) for name, record in given.items()}
    area_m2 = float(np.sum(layout.floor_area_m2))
    allowed = ReadingLimits.of(None, area_m2 if np.isfinite(area_m2) else None, min(layout.u_min))
    runs, gaps = prepared_runs(runs, allowed)
    # What the runs say against themselves, each thing once, where it is surest.
    surest = {}
    for remark in sorted((remark for run in runs for remark in remarks(run, layout)), key=lambda one: one.sure):
        surest[remark.kind, remark.where] = remark
    doubts = list(surest.values())
    pairs, pair_gaps = prepared_pairs(pairs, allowed)
    if pairs:
        check_pairs(pairs)
    metered = _histories(runs, pairs)
    check_steps(metered)
    foreign = foreign_loads(metered if config.foreign_loads else [], layout)
    runs = [foreign.taken_off(run) for run in runs]
    pairs = [replace(p, a=foreign.taken_off(p.a), b=foreign.taken_off(p.b)) for p in pairs]
    notes = [*(remark.in_words() for remark in doubts), *gaps, *pair_gaps]
    return _Records(runs, pairs, _histories(runs, pairs), foreign, doubts, notes, hashes)


def _histories(runs: Sequence[Record], pairs: Sequence[Pair]) -> list[Record]:
    """The runs, then both records of each pair."""
    return [*runs, *(record for pair in pairs for record in (pair.a, pair.b))]


def _named(runs: Sequence[Record], pairs: Sequence[Pair]) -> dict[str, Record]:
    """Every record by its name on the model card."""
    found = {f"run {i}" if len(runs) > 1 else "run": run for i, run in enumerate(runs)}
    for i, pair in enumerate(pairs):
        label = pair.label or str(i)
        found |= {f"pair {label} a": pair.a, f"pair {label} b": pair.b}
    return found


def _estimates(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    records: _Records,
    layout: Layout,
    data: Sequence[ZoneData],
    config: IdentificationConfig,
) -> list[Estimate]:
    """Linear estimate of each actuator's home zone (A,), from the temperatures of the rooms."""
    if config.method == "joint":
        return network_estimates(runs, pairs, layout, data, config, sizes_by_power(layout, records.histories))
    found = []
    for a, zone in enumerate(data):
        with _told(records, layout, a):
            found.append(two_stage_estimate(zone))
    return found


@contextmanager
def _told(
    records: _Records, layout: Layout, a: int, say: Callable[[str], None] = lambda text: None
) -> Iterator[Callable[[str], None]]:
    """Messages and errors name actuator `a` and its zone, where there are several.

    Errors also tell what the records say against themselves.
    """
    names = layout.names
    prefix = "" if names.single else f"{names.actuators[a]} on {names.zones[layout.home[a]]}: "
    try:
        yield lambda text: say(prefix + text)
    except DataError as error:
        doubts = [remark.in_words() for remark in records.doubts]
        raise DataError("; ".join([f"{prefix}{error}", *doubts])) from error


def _powers(
    records: _Records, config: IdentificationConfig, layout: Layout
) -> tuple[list[PowerModel | None], list[list[str]]]:
    """Power of each machine (M,), and notes on it.

    The temperatures do not need it: of several machines, one that was hardly on or whose meter is dead is left out.

    Raises:
        DataError: that of the only machine cannot be fitted.
    """
    machines = layout.names.machines
    powers: list[PowerModel | None] = []
    notes: list[list[str]] = []
    for m, (name, other) in enumerate(zip(machines, records.foreign.power, strict=True)):
        said = []
        try:
            power = power_of_machine(records.histories, config, layout, m)
        except DataError as error:
            if len(machines) == 1:
                raise
            power = None
            said.append(f"{name}: {error}; its power is left out")
        if power is not None and power.cooling is not None and len(layout.fed_by(m)) > 1:
            said.append(f"power of {name}: {power.source}")
        powers.append(power and replace(power, foreign=other))
        notes.append(said)
    return powers, notes


def _times_of(records: Sequence[Record]) -> str:
    """What the model card says of records whose source is not given."""
    if not records or records[0].origin is None:
        return "identified"
    spans = [f"{record.stamps()[0]} to {record.stamps()[-1]}" for record in records]
    return f"records of {'; '.join(spans)}"
