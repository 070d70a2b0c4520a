"""Identification of a thermal model from recorded runs and pairs."""

from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.identification.pipeline import identify

__all__ = ["IdentificationConfig", "Pair", "identify"]
