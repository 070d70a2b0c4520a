"""A controller as it is registered, and what makes one of a class, a function or an object of the user's."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

from controllers.checks import ControllerConfigError
from thermoforce_mpc.data.names import check_same_building
from thermoforce_mpc.protocols import Controller, StandsFor
from thermoforce_mpc.scenario.comfort import Comfort
from thermoforce_mpc.scenario.own_code import called, first_line, options_model, unfit
from thermoforce_mpc.scenario.settings import StrictModel
from thermoforce_mpc.scenario.testcase import TestCase

if TYPE_CHECKING:
    from thermoforce_mpc.model.thermal_model import ThermalModel

# What a plugin's class or function is handed, where it has a parameter of the name.
HANDED = ("testcase", "model")


@dataclass(frozen=True)
class Entry:
    """A controller as it is registered.

    `summary`: one line for `tf-mpc controllers`; `needs_model`: whether it plans with an identified one; `config`
    returns the class of its options, called when the controller is used; `build` makes it from its name, validated
    options, test case and model, or the reason why there is none; `defaults`: its own defaults of options; `suited`:
    those that a test case and the comfort bounds of a scenario make of what the user gave, and the check that it is for
    such a test case.
    """

    summary: str
    needs_model: bool
    config: Callable[[], type[StrictModel]]
    build: Callable[[str, Any, TestCase, ThermalModel | str | None], Controller]
    defaults: Mapping[str, Any] = field(default_factory=dict)
    suited: Callable[[TestCase, Comfort | None, Mapping[str, Any]], Mapping[str, Any]] = lambda *_: {}


@dataclass(frozen=True)
class Chosen:
    """A controller that was looked up and whose options were checked, once: all of it but the model."""

    name: str
    entry: Entry
    config: StrictModel
    testcase: TestCase

    @property
    def needs_model(self) -> bool:
        """Whether it plans with an identified model."""
        return self.entry.needs_model

    @property
    def has_gate(self) -> bool:
        """Whether it stands back where there is no competent model."""
        gate = getattr(self.config, "gate", None)
        return gate is not None and bool(gate.enabled)

    def build(self, model: ThermalModel | str | None = None) -> Controller:
        """The controller on a model, or on the reason why there is none.

        Raises `ConfigError` where it needs a model and has none, or one of the other mode.
        """
        return self.entry.build(self.name, self.config, self.testcase, model)


def build_on_model(
    kind: Callable[..., Controller], name: str, config: Any, testcase: TestCase, model: ThermalModel | str | None
) -> Controller:
    """A controller of `kind` on a model that fits the test case; one that stands back where there is none."""
    if model is None:
        raise ControllerConfigError(f"controller '{name}' needs an identified model: `tf-mpc identify`, then --model")
    if isinstance(model, str):
        from controllers.mpc.acting import NoModelController

        return NoModelController(model, config, testcase.layout, testcase.step_s, name=name)
    of = f"test case '{testcase.name}'"
    check_same_building("the model", model.names, of, testcase.layout.names, error=ControllerConfigError)
    for a, actuator in enumerate(model.operator.actuators):
        mode, expected_mode = model.layout.mode(a), testcase.layout.mode(a)
        if mode != expected_mode:
            of = "" if model.names.single else f" {actuator}"
            raise ControllerConfigError(
                f"the model{of} was identified for {mode}, test case '{testcase.name}' is for {expected_mode}: "
                f"what the one does says nothing of the other; identify on data of {expected_mode}"
            )
    # The test case says what may act together, also to a model that was identified before it did.
    return kind(replace(model, exclusive=testcase.layout.exclusive), config, name=name)


class _Named(StandsFor):
    """A controller by the name that it is registered by: results, journals and reports go by it."""

    name = ""

    def __init__(self, controller: Controller, name: str) -> None:
        super().__init__(controller)
        self.name = name


def named(controller: Controller, name: str) -> Controller:
    """`controller` by `name`; raises `ControllerConfigError` where it is none, and says what it lacks."""
    lacking = [member for member in ("plan", "step_s", "horizon_s") if not hasattr(controller, member)]
    if lacking:
        raise ControllerConfigError(
            f"controller '{name}' is no controller: it has no {' and no '.join(lacking)} (docs/how-to/controller.md)"
        )
    return controller if getattr(controller, "name", None) == name else cast(Controller, _Named(controller, name))


def plugin_entry(name: str, plugin: Entry | Callable[..., Controller]) -> Entry:
    """A plugin's entry, or that of a class or function whose parameters are its options."""
    if isinstance(plugin, Entry):
        return plugin
    needs_model = "model" in inspect.signature(plugin).parameters

    def build(name: str, options: Any, testcase: TestCase, model: ThermalModel | str | None) -> Controller:
        def make(model: ThermalModel | None, config: Any, *, name: str) -> Controller:
            return named(called(plugin, config, {"testcase": testcase, "model": model}), name)

        return build_on_model(make, name, options, testcase, model) if needs_model else make(None, options, name=name)

    return Entry(first_line(plugin) or name, needs_model, lambda: options_model(plugin, HANDED), build)


def own_entry(name: str, own: Any) -> Entry:
    """The entry of a class or function of the user's; raises `ControllerConfigError` where it cannot be used."""
    if wrong := unfit(own, HANDED):
        raise ControllerConfigError(f"controller '{name}' cannot be used: {wrong}")
    return plugin_entry(name, own)
