"""What a controller of a real building knows, kept in a file from step to step for the case that it is started anew.

A record tells most of it again, but not what the watch has found, which sensor is not believed, the highest power so
far, how wide the forecast's interval has to be, and levels that nobody measures.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from controllers.state_classes import STATE_CLASSES
from thermoforce_mpc.errors import InputError, StorageError
from thermoforce_mpc.live.building import Applied
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


_FORMAT = StateFormat((*STATE_CLASSES, Kept, Applied))


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
