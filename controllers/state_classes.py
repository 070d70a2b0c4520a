"""Classes that may be in the file of a controller's state, and the key of who kept it.

A state of a plugin's class cannot be kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from controllers.actuation.actuator import ActuationState
from controllers.monitoring.meters import MeterState
from controllers.monitoring.sun_on_sensors import SunState
from controllers.monitoring.watch import Issued, ScaledModel, Track, WatchState
from controllers.monitoring.zone_sensors import Anchor, SensorState
from controllers.mpc.acting import NoModelState
from controllers.mpc.config import MPCConfig
from controllers.mpc.margins import Innovations, LearnedMargin, Margins
from controllers.mpc.state import MPCState
from controllers.rules.pi import PIState
from controllers.rules.thermostat import ThermostatState
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.commands.command import Command
from thermoforce_mpc.data import Boundary, Names
from thermoforce_mpc.execution.keys import canonical, digest
from thermoforce_mpc.model.card import Competence, HorizonScore, ModelCard
from thermoforce_mpc.model.forced_state import ForcedState
from thermoforce_mpc.model.free_response.calibrated import CalibratedState, IssuedForecasts, Scores
from thermoforce_mpc.model.free_response.following import MeanState
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.free_response.substitute import SubstituteState
from thermoforce_mpc.model.late_sensor import LateSensor
from thermoforce_mpc.model.machine.blocked_hours import BlockedHours, HourEffects, HourSeen
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.other_load import OtherLoad
from thermoforce_mpc.model.machine.power import PowerModel, ReturnWater
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import PredictorState
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor
from thermoforce_mpc.model.thermal_model import ThermalModel, ZoneModel

STATE_CLASSES: tuple[type[Any], ...] = (
    # States of controllers.
    MPCState,
    NoModelState,
    PIState,
    ThermostatState,
    # Parts of an MPC's.
    ActuationState,
    GoodPlan,
    Margins,
    LearnedMargin,
    Innovations,
    MeterState,
    SensorState,
    Anchor,
    SunState,
    WatchState,
    BlockedHours,
    HourEffects,
    HourSeen,
    Track,
    Issued,
    Boundary,
    Names,
    # The predictor, and what free responses keep.
    PredictorState,
    ForcedState,
    SubstituteState,
    CalibratedState,
    IssuedForecasts,
    Scores,
    MeanState,
    # What a watch made of the model, and that model.
    ScaledModel,
    ZoneModel,
    OperatorParameters,
    HeatInput,
    MachineLoad,
    OtherLoad,
    PowerModel,
    ReturnWater,
    RcParameters,
    ModelCard,
    Competence,
    HorizonScore,
    SunOnSensor,
    LateSensor,
)


def model_key(model: ThermalModel) -> str:
    """Key by which what is said of a model is told from what is said of others, 16 digits."""
    return digest({"model": canonical(model)})


def controller_key(model: ThermalModel, config: MPCConfig, commands: Mapping[str, Command] | None = None) -> str:
    """Key by which a kept state tells controllers apart, 16 digits: of the same model, options and commands the same.

    `commands`: what is set, by actuator.
    """
    return digest({"mpc": canonical((model, config))} | ({"commands": canonical(commands)} if commands else {}))
