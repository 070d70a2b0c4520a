"""Registry of controllers by name. A new controller needs one file and one entry here.

Other distributions announce a class, a function or an `Entry` in the group `thermoforce_mpc.controllers`, see
docs/how-to/plugins.md.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from controllers.checks import ControllerConfigError
from controllers.entries.entry import HANDED, Chosen, Entry, build_on_model, named, own_entry, plugin_entry
from controllers.policy.trained import policy_entry
from controllers.rules.native import NativeConfig, NativeController, native_for
from controllers.rules.pi import PIConfig, PIController, pi_for
from controllers.rules.thermostat import Thermostat, ThermostatConfig, thermostat_for
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.registry import Registry
from thermoforce_mpc.scenario.actuator import RoomSetpoints
from thermoforce_mpc.scenario.comfort import Comfort
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


def _dpc_config() -> type[StrictModel]:
    from controllers.policy.config import DPCConfig

    return DPCConfig


def _build_dpc(name: str, config: Any, testcase: TestCase, model: ThermalModel | str | None) -> Controller:
    from controllers.policy.dpc import DPC

    return build_on_model(DPC, name, config, testcase, model)


# The paper's setting: any level in [0, 1] held for the step, 24 h horizon, median of one resolution of the forecaster,
# no margin to the comfort bound, and nothing learned while running.
_AS_PRINTED: dict[str, Any] = {
    "step_s": None,
    "horizon_h": 24.0,
    "comfort_margin_K": 0.0,
    "backoff_level": 0.5,
    "corrections": False,
    "actuation": {"mode": "modulating", "lowest_level": 0.0},
    "gate": {"enabled": False},
    "guard": {"enabled": False},
    "watch": {"enabled": False},
    "sensor": {"enabled": False},
    "free_response": {"name": "chronos", "options": {"resolutions": "one"}},
}

# Room set-points are kept by the plant's own loops within each step, so plans need no reserve for forecast errors.
# Margin and blocks as `bestest_air` was first run (2026-11-22).
_ROOM_SETPOINTS: dict[str, Any] = {
    "comfort_margin_K": 0.03,
    "backoff_level": 0.5,
    "actuation": {"mode": "room_setpoints", "block_s": 60.0},
}

# Valves whose machine's water the plan sets: a machine cycles by itself below a load, so low levels are of use too. By
# judgement, with the valves of `twozone_apartment_hydronic` (2026-11-22).
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
    "rc_mpc_paper": _mpc_entry(
        "the paper's RC-MPC: as thermoforce_paper, with the free response of a linear RC model",
        **{**_AS_PRINTED, "free_response": {"name": "rc"}},
        solver="ipopt",
    ),
    "dpc": Entry(
        "differentiable predictive control: as thermoforce_mpc, with a policy trained through the operator as solver",
        True,
        _dpc_config,
        _build_dpc,
    ),
    "thermostat": Entry(
        "on/off thermostat, optional weekday setback",
        False,
        lambda: ThermostatConfig,
        lambda name, config, testcase, model: Thermostat(config, testcase.layout),
        suited=thermostat_for,
    ),
    "pi": Entry(
        "PI on the comfort bound with anti-windup and optimal start, on/off blocks",
        False,
        lambda: PIConfig,
        lambda name, config, testcase, model: PIController(config, testcase.layout),
        suited=pi_for,
    ),
    "native": Entry(
        "native controller of the plant",
        False,
        lambda: NativeConfig,
        lambda name, config, testcase, model: NativeController(config),
        suited=native_for,
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
    told = getattr(controller, "name", None)  # of a class it may be a property
    name = told if isinstance(told, str) and told else getattr(controller, "__name__", type(controller).__name__)
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


def choose(
    name: str,
    options: Mapping[str, Any],
    testcase: TestCase,
    comfort: Comfort | None = None,
    step_s: float | None = None,
) -> Chosen:
    """The controller `name` with its validated options, defaults included.

    `comfort`: bounds of the scenario; `step_s`: its control step for those that plan with a model. What the user gave
    in `options` comes before either.

    Raises `ConfigError` for wrong options, each key named, or a controller that is not for this kind of test case.
    """
    entry = find_entry(name)
    given = merge({"step_s": step_s}, options) if step_s is not None and entry.needs_model else options
    kind = entry.config()
    fields = kind.model_fields
    behind = _behind_a_supply(testcase)
    defaults = merge(
        merge(entry.defaults, entry.suited(testcase, comfort, given)), _acting(entry, fields, testcase, behind)
    )
    if _free_response_name(given) not in (None, _free_response_name(defaults)):
        defaults.pop("free_response", None)  # its options are those of another
    config = validate(kind, merge(defaults, given), f"options of controller '{name}'")
    _check_supply(config, testcase.layout.names.actuators, behind)
    return Chosen(name, entry, config, testcase)


def controller_config(name: str, options: Mapping[str, Any], testcase: TestCase) -> StrictModel:
    """Validated options of a controller, as `choose` has them."""
    return choose(name, options, testcase).config


def _behind_a_supply(testcase: TestCase) -> list[str]:
    """Actuators whose machine makes water of a temperature that plans set."""
    points = testcase.points
    machines = zip(points.layout.names.actuators, points.layout.machine_of, strict=True)
    return [actuator for actuator, m in machines if points.machines[m].supply is not None]


def _acting(entry: Entry, fields: Collection[str], testcase: TestCase, behind: Collection[str]) -> dict[str, Any]:
    """Options that the kind of the test case's actuators asks for; `fields`: options that there are."""
    actuators, own = [point.actuator for point in testcase.points.actuators], testcase.defaults.actuation
    if all(isinstance(actuator, RoomSetpoints) for actuator in actuators):
        if not entry.needs_model:
            return {}
        of_rooms = merge(_ROOM_SETPOINTS, {"actuation": own} if own else {})
        return {key: value for key, value in of_rooms.items() if key in fields}
    if "actuation" not in fields or "actuation" in entry.defaults:
        return {}
    kinds = [_actuation_by_kind(actuator, entry) for actuator in actuators if isinstance(actuator, Actuator)]
    if len(behind) == len(actuators):
        return {"actuation": {**_SUPPLY, **own}}
    acting = {"actuation": own or kinds[0]}
    return acting | ({"actuations": dict.fromkeys(behind, _SUPPLY)} if behind and "actuations" in fields else {})


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
    return choose(name, options, testcase).build(model)
