"""Models of older file formats, rewritten in today's; each step takes a document and its arrays one version further."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from thermoforce_mpc.data import SINGLE, Array
from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.model.saved.model_file import JSON_NAME, check_target, read_older_file
from thermoforce_mpc.model.thermal_model import ThermalModel, model_from

Document = dict[str, Any]
Arrays = dict[str, Array]


def migrate_model(folder: Path | str, out: Path | str) -> ThermalModel:
    """Rewrite the model in `folder` in today's format to the new folder `out`, and return it.

    Files older than version 4 have no hash of their content: that their numbers were not edited cannot be checked. The
    certificate is proved again. The power of a machine that feeds several actuators cannot be carried over.

    Raises:
        ArtifactError: `folder` holds no model of an older version, is damaged or fails its certificate; `out` exists or
            cannot be written.
    """
    check_target(Path(out), overwrite=False)
    document, arrays = read_older_file(Path(folder))
    try:
        for version in range(document["version"], max(_STEPS) + 1):
            document, arrays = _STEPS[version](document, arrays)
    except DataError as error:
        raise ArtifactError(f"{Path(folder) / JSON_NAME}: {error}") from error
    except (KeyError, TypeError, AttributeError, StopIteration) as error:
        raise ArtifactError(f"{Path(folder) / JSON_NAME}: damaged or edited ({error!r:.200})") from error
    model = model_from(document, arrays, Path(folder) / JSON_NAME)
    model.save(out)
    return model


def _several_zones(document: Document, arrays: Arrays) -> tuple[Document, Arrays]:
    """Version 2 had one zone, one actuator and one machine, without names."""
    new = {"operator.": "pair.0.0.", "free.": "zone.0."}
    moved = {
        next(after + name.removeprefix(before) for before, after in new.items() if name.startswith(before)): array
        for name, array in arrays.items()
    }
    actuator = {"name": SINGLE.actuators[0], "home": 0, "machine": 0, "share": 0.0, "card": document["card"]}
    return {
        "zones": [{"name": SINGLE.zones[0], "free": document["free"]}],
        "actuators": [actuator],
        "machines": [{"name": SINGLE.machines[0], "power": document["power"]}],
        "pairs": [{"zone": 0, "actuator": 0, **document["operator"]}],
    }, moved


def _every_key(document: Document, arrays: Arrays) -> tuple[Document, Arrays]:
    """Version 3 could lack what had been added to it since its beginning."""
    for actuator in document["actuators"]:
        actuator["card"].setdefault("competence", None)
    return document, arrays


def _one_actuator_each(document: Document, arrays: Arrays) -> tuple[Document, Arrays]:
    """Up to version 4 the power of a machine that feeds several actuators was that of their longest or of their sum."""
    fed = [actuator["machine"] for actuator in document["actuators"]]
    for m, machine in enumerate(document["machines"]):
        if machine["power"] is not None and fed.count(m) > 1:
            raise DataError(
                f"machine '{machine['name']}' feeds several actuators, and its power is described otherwise now: "
                "identify again from the same data"
            )
    return document, arrays


# From `model_file.OLDEST_VERSION` on.
_STEPS: dict[int, Callable[[Document, Arrays], tuple[Document, Arrays]]] = {
    2: _several_zones,
    3: _every_key,
    4: _one_actuator_each,
}
