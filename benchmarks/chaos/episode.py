"""One episode: a run behind a faulty proxy, and what must hold of it whatever happened."""

from __future__ import annotations

import logging
import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.chaos.inside import FailingMPC
from benchmarks.chaos.judging import jumps, unsaid_units, wrong_inputs, wrong_steps
from benchmarks.chaos.live import MOST_SILENT_S, Silence
from benchmarks.chaos.proxy import Proxy, serving
from benchmarks.chaos.troubles import Trouble
from boptest_client import TransportConfig
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.errors import PlantError, ThermoForceError
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.run_book import RunBook
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.inputs import UnitDoubts
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.plants.testcases import load_scenario
from thermoforce_mpc.records.journal import NAME, read_journal
from thermoforce_mpc.records.run_folder import log_step, logging_to
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.testcase import TestCase

# Time limits of the client and silence of the proxy, s: silence takes real time, a busy machine needs some.
_CONNECT_S, _READ_S, _SILENT_S = 10.0, 5.0, 5.5


class _Heard(logging.Handler):
    """How long the package said nothing."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.silence = Silence()

    def emit(self, record: logging.LogRecord) -> None:
        """A word is said."""
        self.silence.word()


@contextmanager
def _heard() -> Iterator[_Heard]:
    heard, loggers = (
        _Heard(),
        [logging.getLogger(name) for name in ("thermoforce_mpc", "controllers", "boptest_client")],
    )
    for logger in loggers:
        logger.addHandler(heard)
    try:
        yield heard
    finally:
        for logger in loggers:
            logger.removeHandler(heard)


@dataclass(frozen=True)
class Setting:
    """What all episodes have in common: served plant, building, model, options of the controller, and window."""

    url: str
    testcase: TestCase
    model: ThermalModel
    options: dict[str, Any]
    controller: str
    start_s: float
    days: float


@dataclass(frozen=True)
class Outcome:
    """An episode: how it ended, what was made, and `faults`: what must not be, in words; none if all held.

    `ended`: 'done', 'plant failed' (a named error), or the type of an unhandled exception.
    """

    troubles: tuple[Trouble, ...]
    ended: str
    why: str
    made: dict[str, int]
    steps: int
    jumps: int
    discomfort_Kh: float
    seconds: float
    faults: tuple[str, ...]


def run_episode(
    setting: Setting, troubles: Sequence[Trouble], seed: int, most_Kh: float = math.inf, folder: Path | None = None
) -> Outcome:
    """Run one episode and judge it.

    Args:
        troubles: what goes wrong, and `seed` when.
        most_Kh: discomfort allowed, K·h.
        folder: where the journal is kept; by default nowhere.
    """
    with tempfile.TemporaryDirectory(prefix="tf-mpc-chaos-") as scratch:
        where = folder or Path(scratch)
        where.mkdir(parents=True, exist_ok=True)
        return _run(setting, tuple(troubles), seed, most_Kh, where)


def _run(setting: Setting, troubles: tuple[Trouble, ...], seed: int, most_Kh: float, folder: Path) -> Outcome:
    zone_point = setting.testcase.points.temperatures[0]
    proxy = Proxy(setting.url, troubles, seed, _SILENT_S, zone_point)
    controller = FailingMPC(setting.model, setting.testcase, setting.options, troubles, setting.controller)
    period = Period("chaos", setting.start_s, setting.days * DAY_S)
    config = TransportConfig(connect_timeout_s=_CONNECT_S, read_timeout_s=_READ_S, sleep=proxy.sleep)
    ended, why, began, heard = "done", "", time.perf_counter(), _Heard()
    with serving(proxy) as url:
        scenario = _scenario(setting, url)
        experiment = Experiment.of(scenario)
        through_proxy = replace(
            experiment.plant.entry, build=lambda *_: BoptestPlant(url, setting.testcase, config=config)
        )
        experiment = replace(experiment, plant=replace(experiment.plant, entry=through_proxy))
        book = RunBook.begin(folder, experiment, ["tf-mpc", "chaos"])
        try:
            with (
                logging_to(folder),
                _heard() as heard,
                closing(book.journal),
                closing(book.connect()) as plant,
            ):
                allowed = limits_of(controller, setting.testcase.area_m2, 0.0)
                u_min = setting.testcase.layout.u_min
                plant.noted("loop", {"controller": controller.name})
                run_closed_loop(
                    plant,
                    controller,
                    period,
                    on_step=lambda step: log_step(controller.name, step),
                    allowed=allowed,
                    u_min=u_min,
                    keeper=plant,
                    units=UnitDoubts(setting.testcase.layout, setting.model, setting.testcase.currency),
                )
        except PlantError as error:
            ended, why = "plant failed", str(error)
        except Exception as error:
            ended, why = type(error).__name__, str(error)
            if isinstance(error, ThermoForceError):
                ended = f"{ended} (named)"
    entries = read_journal(folder / NAME).entries
    seen, ahead = proxy.seen, jumps(entries)
    expected = ended == "done" or (ended == "plant failed" and seen.restarted)
    faults = [] if expected else [f"ended with {ended}: {why}"]
    faults += wrong_inputs(seen.inputs) + wrong_steps(entries, seen.step_ends_s, troubles, ended == "done")
    if ended == "done":
        faults += unsaid_units(entries, seen.made)
    if heard.silence.longest_s > MOST_SILENT_S:
        faults.append(f"silent for {heard.silence.longest_s:.0f} s")
    if not (seen.stopped or seen.restarted):
        faults.append("the test was not stopped")
    discomfort_Kh = seen.kpis.get("tdis_tot", math.nan)
    if ended == "done" and not discomfort_Kh <= most_Kh:
        faults.append(f"discomfort {discomfort_Kh:.2f} K·h, allowed are {most_Kh:.2f}")
    steps = sum(entry.kind == "done" for entry in entries)
    made = seen.made | controller.made
    seconds = time.perf_counter() - began
    return Outcome(troubles, ended, why, made, steps, len(ahead), discomfort_Kh, seconds, tuple(faults))


def _scenario(setting: Setting, url: str) -> Scenario:
    return load_scenario(
        None,
        {
            "testcase": setting.testcase.name,
            "plant": {"kind": "boptest", "url": url},
            "controller": {"name": setting.controller, "options": setting.options},
            "days": setting.days,
        },
    )
