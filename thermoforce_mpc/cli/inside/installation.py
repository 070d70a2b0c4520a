"""Checks of an installation: each says what it found and, where something is wrong, what to do."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, Literal

import numpy as np
import requests
from packaging.requirements import Requirement

from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Observation, PlanStatus, Record
from thermoforce_mpc.dependencies import SWITCHES
from thermoforce_mpc.errors import ConfigError, ThermoForceError
from thermoforce_mpc.files import write_whole
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.registry import OWN, Registry
from thermoforce_mpc.scenario.settings import suggestion
from thermoforce_mpc.version import VERSION

State = Literal["ok", "warning", "failed", "skipped"]
_Found = tuple[State, str] | tuple[State, str, str]  # as the fields of `Finding`

_PACKAGE = "thermoforce-mpc"
# A season of one controller leaves a journal of some 200 MB, a comparison several.
_LITTLE_SPACE_GB, _NO_SPACE_GB = 2.0, 0.2
_CLOCK_OFF_S = 60.0
_SLOW_SYNC_S = 0.2
# From where a running loop takes much, MB and s of one core a step: it took 256 MB with pyarrow, which pandas loads,
# and 0.04 s on 2026-11-28. How long it may be tried, s.
_MEMORY_MB, _STEP_S, _LOOP_S = 350.0, 1.0, 300.0


@dataclass(frozen=True)
class Finding:
    """Result of a check; `todo` says what to do where something is wrong."""

    name: str
    state: State
    told: str
    todo: str = ""
    seconds: float = 0.0


def examine(
    *, testcase: str, url: str | None = None, folder: Path = Path("runs"), only: Collection[str] = ()
) -> Iterator[Finding]:
    """Run the checks, one finding after the other; whatever a check raises is its finding.

    `testcase`: what to look for at the service at `url`, if any; `folder`: where runs are written; `only`: their names.

    Raises:
        ConfigError: there is no check of a name in `only`.
    """
    checks: dict[str, Callable[[], _Found]] = {
        "Python": _python,
        "packages": _packages,
        "reports": _reports,
        "plugins": _plugins,
        "plant": _plant,
        **{f"solver {name}": lambda name=name: _solver(name) for name in ("ipopt", "qp", "sqp", "milp")},  # type: ignore[misc]
        "backbone": _backbone,
        "live loop": _live_loop,
        "serving": _serving,
        "service": lambda: _service(testcase, url),
        "clock": lambda: _clock(url),
        "disk": lambda: _disk(folder),
    }
    for name in only:
        if name not in checks:
            raise ConfigError(f"no check '{name}'{suggestion(name, checks)}; there are {', '.join(checks)}")
    for name, check in checks.items():
        if only and name not in only:
            continue
        began = time.perf_counter()
        found: _Found
        try:
            found = check()
        except ModuleNotFoundError as error:
            found = "failed", f"{error.name} is not installed", "pip install --upgrade thermoforce-mpc"
        except ThermoForceError as error:
            found = "failed", str(error), "see the message"
        except Exception as error:  # a broken installation may raise anything
            todo = "install into a fresh virtual environment; if it stays, report it"
            found = "failed", f"{type(error).__name__}: {error}", todo
        yield replace(Finding(name, *found), seconds=time.perf_counter() - began)


def _python() -> _Found:
    summary = f"{sys.version.split()[0]} at {sys.executable}, {_PACKAGE} {VERSION}"
    if sys.prefix == sys.base_prefix:
        return "warning", f"{summary}, no virtual environment", "python3 -m venv .venv, and install there"
    return "ok", summary


def _packages() -> _Found:
    """Versions of what the package requires, as its metadata say."""
    problems, n = [], 0
    for line in requires(_PACKAGE) or ():
        requirement = Requirement(line)
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        n += 1
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            problems.append(f"{requirement} is not installed")
            continue
        if not requirement.specifier.contains(installed, prereleases=True):
            problems.append(f"{requirement.name} {installed} is installed, {requirement.specifier} is required")
    if problems:
        return "failed", "; ".join(problems), "pip install --upgrade thermoforce-mpc"
    return "ok", f"{n} required packages"


def _reports() -> _Found:
    """What dependencies would tell others, and whether it is off."""
    off = ", ".join(f"{one.package} ({one.variable}={one.value})" for one in SWITCHES if one.is_off)
    if on := [one for one in SWITCHES if not one.is_off]:
        told = "; ".join(f"{one.package} {one.does}: {one.variable}={os.environ[one.variable]}" for one in on)
        return "warning", told, f"unset {' '.join(one.variable for one in on)}, and nothing is reported"
    return "ok", f"off: {off}"


def _plugins() -> _Found:
    """Everything that other distributions announce, imported."""
    from controllers.registry import REGISTRY as controllers
    from thermoforce_mpc.connections.registry import REGISTRY as connections
    from thermoforce_mpc.model.free_response.backbones.loading import REGISTRY as backbones
    from thermoforce_mpc.model.free_response.registry import REGISTRY as free_responses
    from thermoforce_mpc.plants.registry import REGISTRY as plants
    from thermoforce_mpc.plants.testcases import MADE_TESTCASES as testcases

    registries: tuple[Registry[Any], ...] = (controllers, plants, free_responses, backbones, connections, testcases)
    plugins = [(registry.kind, entry) for registry in registries for entry in registry.listing() if entry.origin != OWN]
    problems = [f"{kind} '{entry.name}' of {entry.origin}: {entry.problem}" for kind, entry in plugins if entry.problem]
    if problems:
        return "warning", "; ".join(problems), "mend or uninstall these; everything else works without them"
    return "ok", ", ".join(f"{kind} {entry.name}" for kind, entry in plugins) or "none installed"


def _plant() -> _Found:
    """Two hours of the embedded plant."""
    from thermoforce_mpc.boundary.weather import synthetic_weather
    from thermoforce_mpc.plants.embedded import EmbeddedPlant

    plant = EmbeddedPlant(synthetic_weather())
    start = plant.reset(16 * DAY_S, HOUR_S)
    end = plant.advance(1.0, 2 * HOUR_S)
    off = plant.advance(0.0, 2 * HOUR_S)
    if not (np.isfinite(end.T_zone_C).all() and end.power_W[0] > off.power_W[0]):
        return "failed", "the embedded plant computes nonsense", "reinstall numba and numpy"
    return "ok", f"embedded: {start.T_zone_C[0]:.2f} °C, {end.T_zone_C[0]:.2f} °C after 2 h at full level"


def _solver(name: str) -> _Found:
    """A cold house of the solver's kind: it must plan to heat."""
    from controllers import ThermoForceMPC
    from controllers.mpc.config import MPCConfig
    from thermoforce_mpc.model.machine.load import MachineLoad
    from thermoforce_mpc.model.machine.power import PowerModel
    from thermoforce_mpc.model.operator.parameters import linear_operator
    from thermoforce_mpc.model.thermal_model import ThermalModel

    power = PowerModel(MachineLoad((1600.0, 0.0, 2700.0, 0.0), (-20.0, 30.0), lowest_level=1.0))
    model = ThermalModel.single(linear_operator(np.array([0.99]), np.array([0.4]), step_s=HOUR_S), power)
    settings = {"solver": name, "step_s": HOUR_S, "horizon_h": 12.0, "free_response": {"name": "persistence"}}
    config = MPCConfig.model_validate(settings | {"gate": {"enabled": False}, "guard": {"enabled": False}})
    plan = ThermoForceMPC(model, config).plan(_cold_house())
    if plan.status is not PlanStatus.SOLVED or not plan.u.size or plan.u.max() < 0.1:
        return "failed", f"no plan: {plan.why}", "pip install --force-reinstall casadi piqp"
    return "ok", f"{plan.solver_status}, {plan.iterations} iterations"


def _cold_house() -> Observation:
    """Two days at 20.5 °C without heating, and a band from 21 °C on."""
    at_s, ones, zeros = HOUR_S * np.arange(49, dtype=np.float64), np.ones(49), np.zeros((1, 48))
    record = Record(at_s, 20.5 * ones[None], 0.0 * ones, 0.0 * ones, zeros, zeros, zeros)
    ahead, one = at_s[-1] + np.arange(14) * HOUR_S, np.ones(14)
    boundary = Boundary(ahead, 0 * one, 0 * one, 0 * one, 21 * one, 24 * one, 0.25 * one, 0.2 * one)
    return Observation(record, boundary)


def _backbone() -> _Found:
    from thermoforce_mpc.model.free_response.registry import build_free_response

    try:
        method = build_free_response("chronos")
    except ModuleNotFoundError as error:
        return "failed", f"{error.name} is not installed", f"pip install {error.name}"
    observation = _cold_house()
    free_C = 20.0 + np.sin(np.arange(49) * 2 * np.pi / 24)
    forecast = method.forecast(free_C, observation.history, observation.boundary)
    if not np.isfinite(forecast.quantiles_C).all():
        return "failed", "the shipped forecaster returns no numbers", "pip install --force-reinstall torch"
    return "ok", f"shipped forecaster: {forecast.note}"


def _live_loop() -> _Found:
    """Memory and time of some steps at a building that is not there, in a process of its own."""
    command = [sys.executable, "-m", "thermoforce_mpc.cli.inside.loop_load"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LOOP_S, check=False)
    if done.returncode:
        return "failed", (done.stderr.strip().splitlines() or ["it ended"])[-1], "see the message"
    load = json.loads(done.stdout)
    summary = f"{load['MB']:.0f} MB of memory, {load['step_s']:.2f} s of one core a step"
    if not load["planned"]:
        return "failed", f"{summary}, but no plan", "report it"
    if load["MB"] > _MEMORY_MB or load["step_s"] > _STEP_S:
        return (
            "warning",
            f"{summary}: more than usual",
            "a machine with 1 GB and an idle core is enough; is another busy?",
        )
    return "ok", summary


def _serving() -> _Found:
    missing = [name for name in ("flask", "waitress") if importlib.util.find_spec(name) is None]
    if missing:
        summary = f"{', '.join(missing)} not installed: `tf-mpc serve` and `chaos` are not available"
        return "warning", summary, "pip install 'thermoforce-mpc[serve]'"
    return "ok", "flask and waitress: `tf-mpc serve`"


def _service(testcase: str, url: str | None) -> _Found:
    """Select the test case, check its points, and stop it."""
    if url is None:
        return "skipped", "no --url given"
    from boptest_client import TransportConfig
    from thermoforce_mpc.plants.boptest.plant import BoptestPlant

    began = time.perf_counter()
    try:
        with BoptestPlant(url, load_testcase(testcase), config=TransportConfig(read_timeout_s=30.0)) as plant:
            summary = f"version {plant.info.version}, {testcase} selected, its points checked, stopped"
    except ConfigError as error:
        return "failed", str(error), "`--testcase` takes another test case, `tf-mpc testcases` lists them"
    except ThermoForceError as error:
        return "failed", str(error), "is it running? `curl URL/version`"
    return "ok", f"{summary} in {time.perf_counter() - began:.1f} s"


def _clock(url: str | None) -> _Found:
    """Against the service's clock, the system's own verdict, and the time the package was installed."""
    now = datetime.now(UTC)
    summary = f"{now:%Y-%m-%d %H:%M:%S} UTC"
    todo = "set the clock: timedatectl set-ntp true"
    if now.timestamp() < Path(__file__).stat().st_mtime - DAY_S:
        return "failed", f"{summary}: before this package was installed", todo
    if url is not None:
        try:
            at = parsedate_to_datetime(requests.head(url, timeout=5, allow_redirects=False).headers["Date"])
        except (requests.RequestException, KeyError, ValueError):
            summary += ", the service tells none"
        else:
            off_s = (now - at).total_seconds()
            if abs(off_s) > _CLOCK_OFF_S:
                return "warning", f"{summary}: {off_s:+.0f} s from the service's", todo
            summary += ", as the service's"
    synchronised = _synchronised()
    if synchronised is False:
        return "warning", f"{summary}, not synchronised", todo
    return "ok", summary + (", synchronised" if synchronised else "")


def _synchronised() -> bool | None:
    """Whether the system says its clock is synchronised; None where it does not say."""
    if (command := shutil.which("timedatectl")) is None:
        return None
    call = [command, "show", "--property=NTPSynchronized", "--value"]
    try:
        output = subprocess.run(call, capture_output=True, text=True, timeout=5, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return None
    return {"yes": True, "no": False}.get(output)


def _disk(folder: Path) -> _Found:
    """Room and permission where runs are written, and how long the disk takes to confirm."""
    where = next(path for path in (folder.resolve(), *folder.resolve().parents) if path.is_dir())
    todo = f"make room at {where}, or start runs elsewhere (--out)"
    if not os.access(where, os.W_OK):
        return "failed", f"{where} cannot be written", todo
    free_GB = shutil.disk_usage(where).free / 1e9
    with tempfile.TemporaryDirectory(prefix=".tf-mpc-doctor-", dir=where) as scratch:
        began = time.perf_counter()
        write_whole(Path(scratch) / "file", b"x" * 4096)
        sync_s = time.perf_counter() - began
    summary = f"{where}: {free_GB:.1f} GB free, a record is safe after {1e3 * sync_s:.0f} ms"
    if free_GB < _NO_SPACE_GB:
        return "failed", summary, todo
    if free_GB < _LITTLE_SPACE_GB:
        return "warning", summary, todo
    if sync_s > _SLOW_SYNC_S:
        return "warning", f"{summary}, which is slow", "use a local disk for runs on a service"
    return "ok", summary
