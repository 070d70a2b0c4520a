"""Identification: from recorded runs and pairs to a thermal model."""

from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.identification.records import Pair

__all__ = ["IdentificationConfig", "Pair", "identify"]
