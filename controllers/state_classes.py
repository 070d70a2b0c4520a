"""Classes that may be in the file of a controller's state, by their names there, and the key of who kept it.

A class that is renamed or moved keeps its name in the file. A state of a plugin's class cannot be kept.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from controllers.actuation.actuator import ActuationConfig, ActuationState
from controllers.monitoring.meters import MeterConfig, MeterState
from controllers.monitoring.scaled_model import ScaledModel
from controllers.monitoring.sun_on_sensors import SunState
from controllers.monitoring.watch_state import Issued, Track, WatchConfig, WatchState
from controllers.monitoring.zone_sensor_state import Anchor, SensorConfig, SensorState
from controllers.mpc.config import DeadlineConfig, FreeResponseConfig, MoveBlockingConfig, MPCConfig, ObjectiveConfig
from controllers.mpc.margin_rules import LearnedMargin
from controllers.mpc.margins import Margins
from controllers.mpc.no_model import NoModelState
from controllers.mpc.state import MPCState
from controllers.optimisation.solvers.candidate_search import SearchConfig
from controllers.optimisation.solvers.ipopt import IpoptConfig
from controllers.optimisation.solvers.milp import MilpConfig
from controllers.optimisation.solvers.qp_backends import QPConfig
from controllers.rules.pi import PIState
from controllers.rules.thermostat import ThermostatState
from controllers.safety.fallback_policy import FallbackConfig, GoodPlan
from controllers.safety.overrides import GateConfig, GuardConfig
from thermoforce_mpc.data import Boundary, Names
from thermoforce_mpc.execution.keys import canonical, digest
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.competence import Competence, HorizonScore
from thermoforce_mpc.model.forced_state import ForcedState
from thermoforce_mpc.model.free_response.calibrated import CalibratedState, IssuedForecasts, Scores
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.free_response.residual import Weights
from thermoforce_mpc.model.free_response.substitute import SubstituteState
from thermoforce_mpc.model.machine.foreign_load import ForeignLoad
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.machine.return_water import ReturnWater
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import PredictorState
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.model.zone_model import ZoneModel
from thermoforce_mpc.state_file import Stored


def _with_margins(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields of today's `MPCState` from those of the last release, which had its margins apart."""
    margins = Margins(fields["offset_K"], fields["missed"], fields["kept"])
    return {name: value for name, value in fields.items() if name not in ("offset_K", "missed", "kept")} | {
        "margins": margins
    }


def _without_share(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields of today's `Competence` from those of the last release, which had an explained share in place of odds."""
    return {name: value for name, value in fields.items() if name != "explained"}


def _without_covariance(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields of today's `ForcedState` from those of the last release, which could correct it by a filter."""
    return {name: fields[name] for name in ("time_s", "forced_K")}


def _as_factors(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields of `ScaledModel` from those of the last release's adaptation, which kept logarithms."""
    return {
        "model": fields["model"],
        "gain": float(np.exp(fields["log_factors"][0])),
        "heat": float(np.exp(fields["log_heat"])),
    }


STATE_CLASSES = {
    # States of controllers.
    "mpc": Stored(MPCState, "controllers.planner:MPCState", _with_margins),
    "no_model": Stored(NoModelState, "controllers.standing_back:StandingBackState"),
    "pi": Stored(PIState, "controllers.pi:PIState"),
    "thermostat": Stored(ThermostatState, "controllers.thermostat:ThermostatState"),
    # Parts of an MPC's.
    "actuation": Stored(ActuationState, "controllers.actuation:ActuationState"),
    "good_plan": Stored(GoodPlan, "controllers.fallback:GoodPlan"),
    "margins": Stored(Margins),
    "learned_margin": Stored(LearnedMargin, "controllers.missed:Missed"),
    "meter": Stored(MeterState, "controllers.meters:MeterState"),
    "sensor": Stored(SensorState, "controllers.sensor_state:SensorState"),
    "sensor_anchor": Stored(Anchor, "controllers.sensor_state:Anchor"),
    "sun": Stored(SunState, "controllers.sunlit:SunState"),
    "watch": Stored(WatchState, "controllers.watch_state:WatchState"),
    "watch_track": Stored(Track, "controllers.watch_state:Track"),
    "watch_issued": Stored(Issued, "controllers.watch_state:Issued"),
    "boundary": Stored(Boundary, "thermoforce_mpc.data.boundary:Boundary"),
    "names": Stored(Names, "thermoforce_mpc.data.names:Names"),
    # The predictor, and what free responses keep.
    "predictor": Stored(PredictorState, "thermoforce_mpc.model.predictor:PredictorState"),
    "forced": Stored(ForcedState, "thermoforce_mpc.model.forced_state:ForcedState", _without_covariance),
    "substitute": Stored(SubstituteState, "thermoforce_mpc.model.free_response.substitute:SubstituteState"),
    "calibrated": Stored(CalibratedState, "thermoforce_mpc.model.free_response.calibrated:CalibratedState"),
    "calibrated_issued": Stored(IssuedForecasts, "thermoforce_mpc.model.free_response.calibrated:_Issued"),
    "calibrated_scores": Stored(Scores, "thermoforce_mpc.model.free_response.calibrated:_Scores"),
    "residual_weights": Stored(Weights, "thermoforce_mpc.model.free_response.residual:Weights"),
    # What a watch made of the model, and that model.
    "scaled_model": Stored(ScaledModel, "thermoforce_mpc.identification.adaptation:AdaptationState", _as_factors),
    "zone_model": Stored(ZoneModel, "thermoforce_mpc.model.zone_model:ZoneModel"),
    "operator": Stored(OperatorParameters, "thermoforce_mpc.model.operator.parameters:OperatorParameters"),
    "heat_input": Stored(HeatInput, "thermoforce_mpc.model.operator.heat_input:HeatInput"),
    "machine_load": Stored(MachineLoad, "thermoforce_mpc.model.machine.load:MachineLoad"),
    "foreign_load": Stored(ForeignLoad),
    "power": Stored(PowerModel, "thermoforce_mpc.model.machine.power:PowerModel"),
    "return_water": Stored(ReturnWater, "thermoforce_mpc.model.machine.return_water:ReturnWater"),
    "rc": Stored(RcParameters, "thermoforce_mpc.model.free_response.rc:RcParameters"),
    "card": Stored(ModelCard, "thermoforce_mpc.model.card:ModelCard"),
    "competence": Stored(Competence, "thermoforce_mpc.model.competence:Competence", _without_share),
    "horizon_score": Stored(HorizonScore, "thermoforce_mpc.model.competence:HorizonScore"),
    "sun_on_sensor": Stored(SunOnSensor, "thermoforce_mpc.model.sun_on_sensor:SunOnSensor"),
}

# Names in `controller_key` of classes that have moved since states were first kept.
_IN_KEY: dict[type, str] = {
    ActuationConfig: "controllers.actuation.ActuationConfig",
    DeadlineConfig: "controllers.mpc_config.DeadlineConfig",
    FallbackConfig: "controllers.fallback.FallbackConfig",
    FreeResponseConfig: "controllers.mpc_config.FreeResponseConfig",
    GateConfig: "controllers.gate.GateConfig",
    GuardConfig: "controllers.guard.GuardConfig",
    IpoptConfig: "controllers.ipopt.IpoptConfig",
    MPCConfig: "controllers.mpc_config.MPCConfig",
    MeterConfig: "controllers.meters.MeterConfig",
    MilpConfig: "controllers.milp.MilpConfig",
    MoveBlockingConfig: "controllers.mpc_config.MoveBlockingConfig",
    ObjectiveConfig: "controllers.mpc_config.ObjectiveConfig",
    QPConfig: "controllers.qp_backends.QPConfig",
    SearchConfig: "controllers.search.SearchConfig",
    SensorConfig: "controllers.sensor_state.SensorConfig",
    WatchConfig: "controllers.watch_state.WatchConfig",
}


def controller_key(model: ThermalModel, config: MPCConfig) -> str:
    """Key by which a kept state tells controllers apart: of the same model and options it is the same, 16 digits."""
    return digest({"mpc": canonical((model, config), _IN_KEY)})
