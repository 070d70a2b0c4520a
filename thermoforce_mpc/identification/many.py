"""Identification of many buildings, in which a building that fails costs only itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter

from thermoforce_mpc.data import Layout, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.identification.records import Pair
from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class BuildingRecords:
    """What one of many buildings is identified from; see `identify` for all but `name`."""

    name: str
    runs: Sequence[Record] = ()
    pairs: Sequence[Pair] = ()
    layout: Layout | None = None
    config: IdentificationConfig | None = None
    step_s: float | None = None
    source: str | None = None


@dataclass(frozen=True)
class Identified:
    """Result for one building.

    Attributes:
        name: of the building.
        model: None where there is none.
        reason: why there is none, else empty.
        refused: whether its records were refused; without a model and not refused, the program failed on them.
        seconds: wall time.
    """

    name: str
    model: ThermalModel | None
    reason: str = ""
    refused: bool = False
    seconds: float = 0.0


def identify_many(
    buildings: Iterable[BuildingRecords], config: IdentificationConfig | None = None
) -> Iterator[Identified]:
    """Identify buildings of any layouts and records of any lengths.

    A model is that of `identify`, whatever the others are. Buildings are taken one at a time, when the next result is
    asked for, so that memory holds one; `research.bench.identify_many` shows where the time goes.

    Args:
        buildings: records and options of each.
        config: options of the buildings that have none of their own.

    Yields:
        One result for each building, in their order; a building without a model has the reason in its place.
    """
    for building in buildings:
        began = perf_counter()
        model, reason, refused = None, "", False
        try:
            model = identify(
                building.runs,
                building.pairs,
                config=building.config or config,
                layout=building.layout,
                step_s=building.step_s,
                source=building.source,
            )
        except DataError as error:
            reason, refused = str(error), True
        except Exception as error:  # told in its place; the others continue
            reason = f"{type(error).__name__}: {error}"
        yield Identified(building.name, model, reason, refused, perf_counter() - began)
