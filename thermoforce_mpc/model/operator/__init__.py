"""Forced-response operator: the effect of an action on the zone temperature. Imports neither torch nor casadi."""

from thermoforce_mpc.model.operator.building import BuildingOperator, single
from thermoforce_mpc.model.operator.certificate import Certificate, certificate
from thermoforce_mpc.model.operator.features import FEATURES, feature_matrix, time_of_day
from thermoforce_mpc.model.operator.feedback import FeedbackBounds, feedback_bounds, modulation_slope
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.operator.parameters import GAMMA, HIDDEN, OperatorParameters, linear_operator
from thermoforce_mpc.model.operator.rollout import forced_rollout

__all__ = [
    "FEATURES",
    "GAMMA",
    "HIDDEN",
    "IDENTITY",
    "BuildingOperator",
    "Certificate",
    "FeedbackBounds",
    "HeatInput",
    "OperatorParameters",
    "certificate",
    "feature_matrix",
    "feedback_bounds",
    "forced_rollout",
    "linear_operator",
    "modulation_slope",
    "single",
    "time_of_day",
]
