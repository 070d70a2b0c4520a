"""Connection by files that something else writes and reads, such as a gateway or a scheduled job."""

from __future__ import annotations

import glob
import json
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pandas as pd

from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.files import write_whole
from thermoforce_mpc.providers.outlook import Outlook, OutlookConfig


class FilesConnection:
    """Tables of measurements and forecast in CSV or Parquet files, levels in a JSON file"""

    def __init__(
        self,
        measurements: str = "house.csv",
        forecast: str | OutlookConfig = "tomorrow.csv",
        levels: Path = Path("levels.json"),
    ) -> None:
        """Keep the names of the files.

        Args:
            measurements: recent measurements, which something appends to; or a pattern, such as `data/*.csv`.
            forecast: a file of weather, prices and bounds, or services, see docs/how-to/forecasts.md.
            levels: what is to be set, `{"levels": {"heat_pump": 1.0}, "from": …, "until": …}`, times in UTC; never
                half-written. Of an actuator with a command in the map that command, temperatures in °C. A level null,
                or an `until` that has passed: the building's own control.

        Raises:
            ConfigError: levels would be written over what is read.
        """
        reads = {"measurements": measurements} | ({"forecast": forecast} if isinstance(forecast, str) else {})
        for key, name in reads.items():
            if levels.resolve() in {Path(one).resolve() for one in (name, *glob.glob(name))}:
                raise ConfigError(f"connection files: levels: {levels}: is what {key} reads; name another")
        self._measurements, self._outlook, self._levels = measurements, Outlook(forecast), levels

    def measurements(self) -> str:
        """See `Connection.measurements`; raises `DataError` where there is no such file."""
        return _there(self._measurements, "measurements")

    def forecast(self) -> pd.DataFrame | str:
        """See `Connection.forecast`; raises `DataError` where there is no such file."""
        table = self._outlook.now()
        return _there(table, "forecast") if isinstance(table, str) else table

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """See `Connection.write`; raises `StorageError`."""
        now = datetime.now(UTC)
        until = now + timedelta(seconds=seconds)
        # In whole seconds, rounded up: what is to hold for a while must not end before.
        content = {"levels": dict(levels), "from": _text(now), "until": _text(until + timedelta(microseconds=999_999))}
        write_whole(self._levels, json.dumps(content, ensure_ascii=False) + "\n")

    def sets(self) -> Path:
        """See `Connection`: the file of levels."""
        return self._levels

    def close(self) -> None:
        """Nothing is open."""


def _there(name: str, key: str) -> str:
    if not Path(name).exists() and not glob.glob(name):
        raise DataError(f"connection.{key}: {name}: no such file; name it by --set connection.{key}=FILE")
    return name


def _text(at: datetime) -> str:
    return at.isoformat(timespec="seconds")
