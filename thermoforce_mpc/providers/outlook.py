"""Weather and prices ahead as one table: from a file that something renews, or from providers, kept with their age."""

from __future__ import annotations

import hashlib
import io
import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import Field

from thermoforce_mpc.data.prices import price_doubt
from thermoforce_mpc.dependencies import cache_folder
from thermoforce_mpc.errors import PlantError, StorageError, ThermoForceError
from thermoforce_mpc.files import storage_errors, write_whole
from thermoforce_mpc.protocols import Answer, Provider
from thermoforce_mpc.providers.registry import build_provider
from thermoforce_mpc.providers.service import OUTDOOR, PRICE, SUN
from thermoforce_mpc.scenario.settings import StrictModel

_LOG = logging.getLogger(__name__)
# An answer is asked for anew after so long, where the service does not say when; a service that failed, after so long.
_FRESH, _AGAIN = pd.Timedelta("1h"), pd.Timedelta("5min")
# Weather older than this is none; prices say themselves of when they are.
_OLDEST = pd.Timedelta("2D")
# Of the table: its step, and how far it goes back and ahead.
_STEP, _BACK, _AHEAD = "15min", pd.Timedelta("1D"), pd.Timedelta("4D")
# Two rows of weather farther apart are a hole, which the rules of forecasts bridge.
_HOLE_S = 3600.0
_OUTDOOR_C, _SUN_W_M2 = (-80.0, 60.0), (0.0, 1500.0)


class ProviderConfig(StrictModel):
    """A provider by name."""

    name: str
    options: dict[str, Any] = Field(default_factory=dict)
    factor: float = Field(1.0, gt=0, description="prices are multiplied by this, such as 1.19 for a tax")
    add_per_kWh: float = Field(0.0, description="and this is added: grid fees, levies")


class OutlookConfig(StrictModel):
    """Where weather and prices come from."""

    weather: ProviderConfig
    prices: ProviderConfig | None = Field(None, description="null: the map says prices, or --prices a file of them")


class Outlook:
    """The table of `Connection.forecast`, with columns temperature_C, solar_W_m2 and, with prices, price_per_kWh."""

    def __init__(
        self,
        source: str | OutlookConfig,
        folder: Path | None = None,
        clock: Callable[[], pd.Timestamp] = lambda: pd.Timestamp.now("UTC"),
    ) -> None:
        """From a file's name, or providers, whose last answers are kept in `folder` (default: the user's cache)."""
        self._clock, self._source, self._priced = clock, source, False
        self._kept: list[tuple[ProviderConfig, KeptAnswer, str]] = []
        if isinstance(source, OutlookConfig):
            folder = cache_folder() / "providers" if folder is None else folder
            for config, column in ((source.weather, OUTDOOR), (source.prices, PRICE)):
                if config is not None:
                    provider = build_provider(config.name, config.options)
                    self._kept.append((config, KeptAnswer(config, provider, folder, column), column))

    def now(self) -> pd.DataFrame | str:
        """The table or file; raises `PlantError` where there is no weather, or never were prices since it began.

        Prices that are not there any more are NaN: they take no weather down.
        """
        if isinstance(self._source, str):
            return self._source
        now = self._clock()
        index = pd.date_range((now - _BACK).floor("1h"), now + _AHEAD, freq=_STEP, name="time")
        columns: dict[str, Any] = {}
        for config, kept, column in self._kept:
            try:
                answer = kept.at(now)
            except PlantError as error:
                if column != PRICE or not self._priced:
                    raise
                _LOG.warning("%s: no prices", error)
                columns[PRICE] = np.full(len(index), np.nan)
                continue
            if column == PRICE:
                self._priced = True
                columns[PRICE] = _of_intervals(index, answer) * config.factor + config.add_per_kWh
            else:
                for name in (OUTDOOR, SUN):
                    columns[name] = _straight(index, answer.table[name])
        table = pd.DataFrame(columns, index=index)
        known = np.flatnonzero(np.isfinite(table[OUTDOOR].to_numpy()))
        if not known.size or index[known[-1]] <= now:
            raise PlantError("the weather forecast ends before now")
        return table.iloc[: known[-1] + 1]


class KeptAnswer:
    """The last good answer of a provider, in memory and in a file, asked anew where it is no longer fresh."""

    def __init__(self, config: ProviderConfig, provider: Provider, folder: Path, column: str) -> None:
        """`column`: the one that must be there."""
        self._name, self._provider, self._column = config.name, provider, column
        digest = hashlib.sha256(json.dumps([config.name, config.options], default=str, sort_keys=True).encode())
        self._file = folder / f"{config.name}-{digest.hexdigest()[:16]}.json"
        self._last: _Last | None = None
        self._tried: pd.Timestamp | None = None
        self._loaded = False

    def at(self, now: pd.Timestamp) -> Answer:
        """The answer to use at `now`; raises `PlantError` where none is good."""
        if not self._loaded:
            self._loaded, self._last = True, _read(self._file)
        last = self._last
        since = _AGAIN if self._tried is None else now - self._tried
        waits = pd.Timedelta(0) <= since < _AGAIN
        if last is not None and (waits or last.asked <= now < last.fresh):
            return last.answer
        problem: Exception
        if waits:
            raise PlantError(f"{self._name} failed {since.total_seconds() / 60:.0f} min ago")
        self._tried = now
        try:
            answer = self._provider.answer(now, dict(last.answer.state) if last else {})
            if answer.unchanged:
                if last is None:
                    raise PlantError(f"{self._name}: says that its answer is unchanged, but there is none")
                answer = Answer(last.answer.table, last.answer.holds_s, answer.fresh, answer.state)
            answer = Answer(_checked(self._name, answer, now, self._column), answer.holds_s, answer.fresh, answer.state)
            fresh = now + _FRESH if answer.fresh is None else min(pd.Timestamp(answer.fresh), now + 6 * _FRESH)
            self._last = _Last(answer, now, fresh)
            self._keep()
            return answer
        except ThermoForceError as error:
            problem = error
        except Exception as error:  # somebody's provider may raise anything
            problem = error
            _LOG.warning("provider %s", self._name, exc_info=error)
        if last is None or now - last.asked > _OLDEST:
            raise PlantError(f"no answer of {self._name}: {problem}") from problem
        age = (now - last.asked).total_seconds() / 3600.0
        _LOG.warning("%s: %s; the answer of %.1f h ago stands in", self._name, problem, age)
        return last.answer

    def _keep(self) -> None:
        assert self._last is not None
        try:
            with storage_errors(self._file.parent):
                self._file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self._file, self._last.text())
        except StorageError as error:
            _LOG.warning("the answer of %s is not kept: %s", self._name, error)


@dataclass(frozen=True)
class _Last:
    answer: Answer
    asked: pd.Timestamp
    fresh: pd.Timestamp

    def text(self) -> str:
        table = self.answer.table.rename_axis(index="time").to_csv(lineterminator="\n")
        return json.dumps(
            {"asked": self.asked.isoformat(), "fresh": self.fresh.isoformat(), "holds_s": self.answer.holds_s,
             "state": dict(self.answer.state), "table": table}
        )  # fmt: skip


def _read(file: Path) -> _Last | None:
    """What was kept; None where there is none, or it cannot be used."""
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
        table = pd.read_csv(io.StringIO(said["table"]), index_col=0)
        table.index = pd.DatetimeIndex(pd.to_datetime(table.index, utc=True))
        answer = Answer(table.astype(float), float(said["holds_s"]), None, dict(said["state"]))
        return _Last(answer, pd.Timestamp(said["asked"]), pd.Timestamp(said["fresh"]))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        _LOG.warning("%s cannot be used (%s): asked anew", file, error)
        return None


def _checked(name: str, answer: Answer, now: pd.Timestamp, column: str) -> pd.DataFrame:
    """The table in order, without what cannot be; raises `PlantError` for one of other days or of another unit."""
    table = answer.table
    needed = (OUTDOOR, SUN) if column == OUTDOOR else (PRICE,)
    if lacking := [key for key in needed if key not in table]:
        raise PlantError(f"{name}: its answer has no {', '.join(lacking)}")
    if not isinstance(table.index, pd.DatetimeIndex) or table.index.tz is None:
        raise PlantError(f"{name}: its stamps have no zone")
    table = table.tz_convert("UTC").sort_index()
    table = table[~table.index.duplicated(keep="last")][list(needed)].astype(float)
    table = table.where(np.isfinite(table))
    ahead = table[needed[0]].dropna()
    holds = pd.Timedelta(seconds=max(answer.holds_s, 1.0))
    if ahead.empty or ahead.index[-1] + holds <= now or ahead.index[0] > now + pd.Timedelta("6h"):
        reach = "nothing" if ahead.empty else f"{ahead.index[0]} to {ahead.index[-1]}"
        raise PlantError(f"{name}: its answer is of {reach}, not of now ({now})")
    if column == PRICE:
        if doubt := price_doubt(ahead.to_numpy()):
            raise PlantError(f"{name}: {doubt}")
        return table
    for key, (least, most) in ((OUTDOOR, _OUTDOOR_C), (SUN, _SUN_W_M2)):
        values = table[key].dropna()
        if not values.between(least - 1.0, most).all():
            raise PlantError(f"{name}: {key} from {values.min():g} to {values.max():g}, which cannot be")
    return table.assign(**{SUN: table[SUN].clip(lower=0.0)})


def _straight(index: pd.DatetimeIndex, column: pd.Series) -> np.ndarray[Any, Any]:
    """Weather straight between two rows at most an hour apart, else NaN (the last row stands for itself)."""
    known = column.dropna()
    if known.empty:
        return np.full(len(index), np.nan)
    at_s, grid_s = _seconds(pd.DatetimeIndex(known.index)), _seconds(index)
    out = np.interp(grid_s, at_s, known.to_numpy(), left=np.nan, right=np.nan)
    place = np.clip(np.searchsorted(at_s, grid_s), 1, max(at_s.size - 1, 1))
    if at_s.size > 1:
        hole = (at_s[place] - at_s[place - 1] > _HOLE_S) & ~np.isin(grid_s, at_s)
        out[hole] = np.nan
    return out


def _of_intervals(index: pd.DatetimeIndex, answer: Answer) -> np.ndarray[Any, Any]:
    """The price of the interval that each instant lies in; NaN where there is none."""
    known = answer.table[PRICE].dropna()
    at_s, grid_s = _seconds(pd.DatetimeIndex(known.index)), _seconds(index)
    place = np.searchsorted(at_s, grid_s, side="right") - 1
    inside = (place >= 0) & (grid_s < at_s[np.maximum(place, 0)] + max(answer.holds_s, 1.0))
    return np.where(inside, known.to_numpy()[np.maximum(place, 0)], np.nan)


def _seconds(index: pd.DatetimeIndex) -> np.ndarray[Any, Any]:
    return np.asarray((index - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1), dtype=np.float64)
