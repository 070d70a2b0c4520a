"""Registry of controllers by name. A new controller needs one file and one entry here.

Other distributions announce a class, a function or an `Entry` in the group `thermoforce_mpc.controllers`, see
docs/how-to/plugins.md.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from controllers.checks import ControllerConfigError
from controllers.entries.entry import HANDED, Entry, build_on_model, named, own_entry, plugin_entry
from controllers.policy.trained import policy_entry
from controllers.rules.native import NativeConfig, NativeController
from controllers.rules.pi import PIConfig, PIController, check_layout
from controllers.rules.thermostat import Thermostat, ThermostatConfig
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.registry import Registry
from thermoforce_mpc.scenario.actuator import RoomSetpoints
from thermoforce_mpc.scenario.own_code import first_line, is_own_code, is_policy, own_code, unfit
from thermoforce_mpc.scenario.settings import StrictModel, merge, validate
from thermoforce_mpc.scenario.testcase import Actuator, TestCase

if TYPE_CHECKING:  # CasADi and the predictor are loaded only when a controller needs them
    from thermoforce_mpc.model.thermal_model import ThermalModel


def _mpc_config() -> type[StrictModel]:
    from controllers.mpc.config import MPCConfig

    return MPCConfig


def _build_mpc(name: str, config: Any, testcase: TestCase, model: ThermalModel | str | None) -> Controller:
    from controllers.mpc.controller import ThermoForceMPC

    return build_on_model(ThermoForceMPC, name, config, testcase, model)


def _mpc_entry(summary: str, **defaults: Any) -> Entry:
    return Entry(summary, True, _mpc_config, _build_mpc, defaults)


# The paper's setting: any level in [0, 1] held for the step, 24 h horizon, median of one resolution of the forecaster,
# no margin to the comfort bound, and nothing learned while running.
_AS_PRINTED: dict[str, Any] = {
    "step_s": None,
    "horizon_h": 24.0,
    "comfort_margin_K": 0.0,
    "backoff_level": 0.5,
    "backoff_level_other": 0.5,
    "backoff_violation_K": None,
    "offset_h": None,
    "actuation": {"mode": "modulating", "lowest_level": 0.0},
    "gate": {"enabled": False},
    "guard": {"enabled": False},
    "reserve": False,
    "watch": {"enabled": False},
    "sensor": {"enabled": False},
    "free_response": {"name": "chronos", "options": {"resolutions": "one"}},
}

# Room set-points are kept by the plant's own loops within each step, so plans need no reserve for forecast errors.
_ROOM_SETPOINTS: dict[str, Any] = {
    "comfort_margin_K": 0.03,
    "backoff_level": 0.5,
    "backoff_level_other": 0.5,
    "backoff_violation_K": None,
    "actuation": {"mode": "room_setpoints", "block_s": 60.0},
}

# Valves whose machine's water the plan sets: a machine cycles by itself below a load, so low levels are of use too.
_SUPPLY: dict[str, Any] = {"mode": "supply", "lowest_level": 0.2}

_OWN: dict[str, Entry] = {
    "thermoforce_mpc": _mpc_entry(
        "MPC: free response of a linear weather model and a frozen forecaster, on/off blocks, 15 min step"
    ),
    "thermoforce_paper": _mpc_entry(
        "the paper's setting: frozen forecaster on T - F, level held for the test case's step, Ipopt",
        **_AS_PRINTED,
        solver="ipopt",
    ),
    "rc_mpc": _mpc_entry(
        "as thermoforce_mpc, with the free response of a linear RC model", free_response={"name": "rc"}
    ),
    "thermostat": Entry(
        "on/off thermostat, optional weekday setback",
        False,
        lambda: ThermostatConfig,
        lambda name, config, testcase, model: Thermostat(config, testcase.layout),
        {},
    ),
    "pi": Entry(
        "PI on the comfort bound with anti-windup and optimal start, on/off blocks",
        False,
        lambda: PIConfig,
        lambda name, config, testcase, model: PIController(config, testcase.layout),
        {},
    ),
    "native": Entry(
        "native controller of the plant",
        False,
        lambda: NativeConfig,
        lambda name, config, testcase, model: NativeController(config),
        {},
    ),
}


REGISTRY: Registry[Entry] = Registry(
    "controller",
    "controllers",
    _OWN,
    ControllerConfigError,
    lambda plugin: "" if isinstance(plugin, Entry) else unfit(plugin, HANDED),
    plugin_entry,
)


_lent: dict[str, Entry] = {}


@contextmanager
def lent(controller: Controller | type) -> Iterator[str]:
    """The name by which a controller, or a class of one, is known while the block lasts.

    Raises `ControllerConfigError` where it cannot be used, or its name is that of another controller.
    """
    name = str(getattr(controller, "name", None) or getattr(controller, "__name__", type(controller).__name__))
    if name in REGISTRY or name in _lent:
        raise ControllerConfigError(f"controller '{name}' is there already: give yours another `name`")
    if isinstance(controller, type):
        _lent[name] = own_entry(name, controller)
    else:
        given = named(controller, name)
        _lent[name] = Entry(first_line(controller) or name, False, lambda: StrictModel, lambda *_: given)
    try:
        yield name
    finally:
        del _lent[name]


def find_entry(name: str) -> Entry:
    """The entry of `name`, also of a class or function `file.py:name` of the user's, or a trained policy `file.zip`.

    Raises `ControllerConfigError` where there is none, with a suggestion and all known names.
    """
    if is_own_code(name):
        return own_entry(name, own_code(name, "controller", ControllerConfigError))
    if is_policy(name):
        return policy_entry(name)
    return _lent[name] if name in _lent else REGISTRY.find(name)


def controller_config(name: str, options: Mapping[str, Any], testcase: TestCase) -> StrictModel:
    """Validated options of a controller, defaults included.

    Raises `ConfigError` for wrong options, each key named, or a controller that is not for this kind of test case.
    """
    entry = find_entry(name)
    defaults: dict[str, Any] = dict(entry.defaults)
    if name == "native":
        defaults["step_s"] = testcase.step_s
    if name in ("thermostat", "pi"):
        defaults["mode"] = "cooling" if testcase.layout.mode(0) == "cooling" else "heating"
    if name == "pi":
        check_layout(testcase.layout)
    points = testcase.points
    actuators = [point.actuator for point in points.actuators]
    machines = zip(points.layout.names.actuators, points.layout.machine_of, strict=True)
    behind = [actuator for actuator, m in machines if points.machines[m].supply is not None]
    if all(isinstance(actuator, RoomSetpoints) for actuator in actuators):
        if entry.needs_model:
            own = {"actuation": testcase.defaults.actuation} if testcase.defaults.actuation else {}
            fields = entry.config().model_fields
            of_rooms = {key: value for key, value in merge(_ROOM_SETPOINTS, own).items() if key in fields}
            defaults = dict(merge(defaults, of_rooms))
    elif "actuation" in entry.config().model_fields and "actuation" not in entry.defaults:
        kinds = [_actuation_by_kind(actuator, entry) for actuator in actuators if isinstance(actuator, Actuator)]
        defaults["actuation"] = testcase.defaults.actuation or kinds[0]
        if len(behind) == len(actuators):
            defaults["actuation"] = {**_SUPPLY, **testcase.defaults.actuation}
        elif behind and "actuations" in entry.config().model_fields:
            defaults["actuations"] = dict.fromkeys(behind, _SUPPLY)
    if name == "thermostat":
        set_points = {
            actuator: zone.thermostat_C
            for actuator, home in zip(points.layout.names.actuators, points.layout.home, strict=True)
            if (zone := points.zones[home]).thermostat_C is not None
        }
        if testcase.thermostat_C is not None:
            defaults["setpoint_C"] = testcase.thermostat_C
        elif set_points:
            defaults["setpoints_C"] = set_points
    if _free_response_name(options) not in (None, _free_response_name(defaults)):
        defaults.pop("free_response", None)  # its options are those of another
    config = validate(entry.config(), merge(defaults, options), f"options of controller '{name}'")
    _check_supply(config, points.layout.names.actuators, behind)
    return config


def _free_response_name(options: Mapping[str, Any]) -> Any:
    chosen = options.get("free_response")
    return chosen.get("name") if isinstance(chosen, Mapping) else None


def _check_supply(config: StrictModel, actuators: Sequence[str], behind: Collection[str]) -> None:
    common, own = getattr(config, "actuation", None), getattr(config, "actuations", {})
    for actuator in actuators:
        actuation = own.get(actuator, common)
        if actuation is not None and actuation.mode == "supply" and actuator not in behind:
            raise ControllerConfigError(
                f"controller.options.actuation.mode: supply is for valves whose machine has `supply` in the test case "
                f"file, which that of {actuator} has not; use auto"
            )


def has_gate(name: str, options: Mapping[str, Any], testcase: TestCase) -> bool:
    """Whether a controller stands back where there is no competent model; raises `ConfigError` for wrong options."""
    gate = getattr(controller_config(name, options, testcase), "gate", None)
    return gate is not None and gate.enabled


def _actuation_by_kind(actuator: Actuator, entry: Entry) -> dict[str, Any]:
    """What the actuator's kind says where nobody names an actuation; empty: the default, `mode: auto`.

    A set-point is held, not switched: the loop that follows it decides how its machine runs. A rule has no model to
    decide from, so it also modulates an actuator whose map makes heat proportional to the level.
    """
    physical = actuator.map != "linear" and not entry.needs_model
    if actuator.kind == "setpoint" or physical:
        return {"mode": "modulating", "lowest_level": 0.0}
    return {}


def build_controller(
    name: str, options: Mapping[str, Any], testcase: TestCase, model: ThermalModel | str | None = None
) -> Controller:
    """Build a controller of the registry by name.

    `model`: identified, or the reason why none could be: then a controller that needs one stands back for the whole
    run.

    Raises:
        ConfigError: wrong options, a missing model, or one of the other mode.
    """
    config = controller_config(name, options, testcase)
    return find_entry(name).build(name, config, testcase, model)
