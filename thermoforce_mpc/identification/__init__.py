"""Identification of a thermal model from recorded runs and pairs."""

from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.many import BuildingRecords, Identified, identify_many
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.identification.records import Pair

__all__ = ["BuildingRecords", "IdentificationConfig", "Identified", "Pair", "identify", "identify_many"]
