"""What is kept of a run at a real building: what the controller knows, from step to step for the case that it is
started anew, and what the journal says of building, controller and model.

A record tells most of it again, but not what the watch has found, which sensor is not believed, the highest power so
far, how wide the forecast's interval has to be, and levels that nobody measures.
"""

from __future__ import annotations

import logging
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from controllers.mpc.config import MPCConfig
from controllers.state_classes import STATE_CLASSES
from thermoforce_mpc.errors import InputError, StorageError
from thermoforce_mpc.experiment.run_models import origin
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.identification.probing.excitation import RoomsState
from thermoforce_mpc.identification.probing.probe import LevelsState, ProbingState
from thermoforce_mpc.live.building import Applied
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.model.saved import JSON_NAME
from thermoforce_mpc.model.thermal_model import load_model
from thermoforce_mpc.records.live_journal import RealRun
from thermoforce_mpc.records.run_folder import plain_json
from thermoforce_mpc.scenario.scenario import ControllerSpec, Scenario
from thermoforce_mpc.state_file import StateFormat

_LOG = logging.getLogger(__name__)
# After a longer pause too much has changed.
_OLDEST = pd.Timedelta(days=1)


@dataclass(frozen=True)
class Kept:
    """The controller's state `before` and `after` the decision at `instant`, and levels `applied` so far.

    Seconds count from `origin`; both times in ISO 8601. `of` tells controllers apart.
    """

    origin: str
    instant: str
    before: object
    after: object
    applied: tuple[Applied, ...]
    of: str = ""

    def state_at(self, instant: pd.Timestamp) -> object:
        """The state to decide with at `instant`; the step that was decided already is decided once more."""
        return self.before if instant == pd.Timestamp(self.instant) else self.after


_FORMAT = StateFormat((*STATE_CLASSES, ProbingState, LevelsState, RoomsState, Kept, Applied))


class KeptState:
    """The file at `path`, of the `controller` with this digest of model and options. It stops no control: what is wrong
    with the file is in the log."""

    def __init__(self, path: Path, controller: str) -> None:
        self._path, self._controller = path, controller
        self._failed = False

    def load(self, now: pd.Timestamp) -> Kept | None:
        """What was kept less than a day ago of the same controller; None where there is none."""
        if not self._path.exists():
            return None
        try:
            kept = _FORMAT.read(self._path)
        except InputError as error:
            _LOG.warning("%s: begun anew", error)
            return None
        if not isinstance(kept, Kept) or kept.of != self._controller:
            wrong = "another model or other options: begun anew"
        elif now - pd.Timestamp(kept.instant) > _OLDEST:
            wrong = f"{kept.instant}, more than a day ago: begun anew"
        elif now < pd.Timestamp(kept.instant):
            wrong = f"{kept.instant}, which is to come: was the clock set back? Begun anew"
        else:
            _LOG.info("goes on from the state of %s in %s", kept.instant, self._path)
            return kept
        _LOG.warning("%s is of %s", self._path, wrong)
        return None

    def save(self, content: Kept) -> None:
        """Keep what is known; a first failure is in the log."""
        try:
            _FORMAT.write(self._path, replace(content, of=self._controller))
        except (StorageError, TypeError) as error:
            if not self._failed:
                _LOG.warning("the state is not kept, and a restart begins anew: %s", error)
            self._failed = True


def real_run(
    out: Path,
    model: Path | None,
    map_file: Path,
    rules: MeasurementMap,
    options: MPCConfig,
    connection: str,
    controller: str = "thermoforce_mpc",
) -> RealRun:
    """The run of a controller with the model in the folder `model`, if any, of which a copy is kept in `out`.

    Raises `ArtifactError` where the model is damaged.
    """
    spec = ControllerSpec(name=controller, options=options.model_dump(mode="json", exclude_unset=True))
    models = {} if model is None else {spec.name: _kept_model(out, model)}
    return RealRun(
        name=map_file.stem,
        zone=rules.time.zone or "UTC",
        currency="currency",  # a map has prices, and does not say in what
        scenario=Scenario(testcase=map_file.stem, controller=spec, baselines=()),
        command=("tf-mpc", *sys.argv[1:]),
        connection=connection,
        models=models,
    )


def _kept_model(out: Path, model: Path) -> dict[str, Any]:
    """What the journal says of a model, of which a copy is kept in the folder `out` under a name of its own."""
    thermal, sha256 = load_model(model), file_sha256(model / JSON_NAME)
    name = f"model-{sha256[:8]}"
    refused = ""
    if not (out / name / JSON_NAME).is_file():
        try:
            thermal.save(out / name)
        except StorageError as error:
            refused = str(error)
    of = {"sha256": sha256, "refused": refused, "origin": plain_json(origin(thermal))}
    return {"folder": None if refused else name, **of}
