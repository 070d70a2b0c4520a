"""Connection to Home Assistant: states and history in, service calls out, each read back.

What its API does that one would not expect, seen on core 2025.4.4 (tests/with_home_assistant): a service call on an
entity that is not there answers 200; a number outside an entity's range answers 400 or 500; a step is not enforced; an
entity without history is left out of the answer without a word. So every value is checked against the entity before it
is sent, and read back after.
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import pandas as pd
import requests
from pydantic import Field

from thermoforce_mpc.connections.away import not_reached
from thermoforce_mpc.data import Array
from thermoforce_mpc.data.clock import in_celsius, in_fahrenheit
from thermoforce_mpc.errors import ConfigError, PlantError, suggestion
from thermoforce_mpc.files import no_secret_in, secret_from
from thermoforce_mpc.measurements.tables.raw_table import SWITCH
from thermoforce_mpc.providers.outlook import Outlook, OutlookConfig
from thermoforce_mpc.scenario.settings import StrictModel

_LOG = logging.getLogger(__name__)
_TIMEOUT_S = 10.0
# A command so far from what a device takes, as a share of its step, is of another step; a change of unit brings less.
_ANOTHER_STEP = 0.2
# States asked for at once: a meter that reports every second has 86 400 a day.
_PIECE = timedelta(days=1)
# States of the last minutes are asked for again: the recorder writes them up to 5 s late.
_AGAIN_S = 120.0
# By then what an entity said is in the history, s.
_RECORDED_S = 60.0
# How long a device may take to say what it was set to, and between two looks, s.
TAKEN_S, _LOOK_S = 8.0, 0.25
# While Home Assistant is down nothing is stored of anything: a silence of all entities so many times as long as usual
# (99th percentile), and at least so long, s.
_SILENCE, _SILENCE_S = 10.0, 900.0
_MOST_BYTES = 256 * 1024 * 1024
_GONE = ("unavailable", "unknown")
# What thermostats say that they do (`hvac_action`), as a level.
_ACTIONS = {"heating": 1.0, "preheating": 1.0, "cooling": 1.0, "idle": 0.0, "defrosting": 0.0, "fan": 0.0}
_HOLDS_TEMPERATURE = ("climate", "water_heater")
# Attributes without a unit of their own.
_TEMPERATURES = (
    "current_temperature", "temperature", "target_temp_low", "target_temp_high", "apparent_temperature", "dew_point",
)  # fmt: skip
_IN_PERCENT = ("current_humidity", "humidity", "current_position", "percentage")
# A number in °F of this least value or more is a temperature: no device takes changes of 22 K at least, and set-points
# of rooms begin at 45 °F.
_LEAST_TEMPERATURE_F = 40.0
_HOLDS_NUMBER = ("number", "input_number")
_HOLDS_SWITCH = ("switch", "input_boolean")
_HOLDS_OPTION = ("select", "input_select")
_SETTABLE = (*_HOLDS_TEMPERATURE, *_HOLDS_NUMBER, *_HOLDS_SWITCH, *_HOLDS_OPTION)


class HomeAssistantActuator(StrictModel):
    """What is set for an actuator of the map."""

    entity: str = Field(description=f"entity of the domain {', '.join(_SETTABLE)}")
    release: float | bool | str = Field(
        description="what it is set to when the building is given back to its own control, as the entity has it"
    )
    scale: float = Field(1.0, gt=0, description="a number entity is set to the level or command times this")
    options: dict[float, str] = Field(
        default_factory=dict, description="option of a select entity for each command, as {1: blocked, 2: normal}"
    )

    @property
    def domain(self) -> str:
        """Domain of the entity."""
        return self.entity.partition(".")[0]


class _Target(NamedTuple):
    """A service call, and what the entity should hold after it."""

    service: str
    data: dict[str, Any]
    attribute: str | None
    value: float | str
    tolerance: float


class HomeAssistantConnection:
    """Home Assistant: entities as columns, climate, number, switch, select and water heater entities to set"""

    def __init__(
        self,
        url: str = "http://homeassistant.local:8123",
        actuators: dict[str, HomeAssistantActuator] | None = None,
        token_file: Path | None = None,
        watchdog: str | None = None,
        forecast: str | OutlookConfig = "tomorrow.csv",
        days: float = 28.0,
        every_s: float = 60.0,
    ) -> None:
        """Check the options; nothing is asked yet.

        Columns of the map are entities (`sensor.hall`) or their attributes (`climate.hall.current_temperature`).

        Args:
            url: its address; in an add-on http://supervisor/core.
            actuators: what to set, by the name in the map: `{heat_pump: {entity: climate.hall, release: 20}}`.
            token_file: file with a long-lived access token, of mode 600; without it the environment variable
                HOME_ASSISTANT_TOKEN, or SUPERVISOR_TOKEN of an add-on.
            watchdog: a timer entity that is started anew with each command, for as long as the command holds. An
                automation at its end gives the building back where nothing came any more (`tf-mpc init --for
                home-assistant` writes one).
            forecast: a file of weather, or services, see docs/how-to/forecasts.md.
            days: of history; older than what the recorder keeps are long-term statistics, of hours.
            every_s: rows of the table, s.
        """
        if not (days > 0.0 and every_s > 0.0):
            raise ConfigError("connection home-assistant: days and every_s are above 0")
        no_secret_in(url, "connection home-assistant: url", "the token in HOME_ASSISTANT_TOKEN or token_file")
        if not url.startswith(("http://", "https://")):
            raise ConfigError(f"connection home-assistant: url: {url!r}: expected http://HOST:PORT or https://…")
        self._url, self._days, self._every_s, self._watchdog = url.rstrip("/"), days, every_s, watchdog
        self._actuators = actuators or {}
        for name, one in self._actuators.items():
            _check(name, one)
        if watchdog is not None and not watchdog.startswith("timer."):
            raise ConfigError(f"connection home-assistant: watchdog: {watchdog!r} is no timer entity")
        self._token = secret_from(
            token_file, ("HOME_ASSISTANT_TOKEN", "SUPERVISOR_TOKEN"), "connection home-assistant: token_file"
        )
        self._outlook = Outlook(forecast)
        self._columns: tuple[str, ...] = ()
        self._seen: dict[str, _States] = {}
        self._entities: dict[str, Mapping[str, Any]] = {}  # as they were when they were last there
        self._away: dict[str, list[tuple[float, float]]] = {}  # when they were not, s; infinite: yet
        self._rounded: set[str] = set()
        self._session = requests.Session()
        self._session.trust_env = False  # no proxy, no .netrc: the token goes to this address alone

    def reads(self, columns: Iterable[str]) -> None:
        """See `Connection`: the columns of the map."""
        self._columns = tuple(dict.fromkeys(columns))
        for column in self._columns:
            if len(column.split(".")) not in (2, 3):
                raise ConfigError(
                    f"map: column '{column}': connection home-assistant reads entities, such as sensor.hall, or "
                    "attributes, such as climate.hall.current_temperature"
                )

    def sets(self) -> tuple[str, ...]:
        """See `Connection`."""
        return tuple(sorted({f"home-assistant {self._url.lower()} {one.entity}" for one in self._actuators.values()}))

    def measurements(self) -> pd.DataFrame:
        """See `Connection.measurements`; raises `PlantError`."""
        return self.history(self._days)

    def history(self, days: float) -> pd.DataFrame:
        """A row a minute of the last `days`, NaN while an entity was unavailable, or is away that was there; raises
        `PlantError`.

        `attrs["units"]`: by column, in which unit Home Assistant tells it.
        """
        now = datetime.now(UTC)
        begin = now - timedelta(days=days)
        entities = list(dict.fromkeys(_entity(column) for column in self._columns))
        if not entities:
            raise ConfigError("connection home-assistant: no columns to read: give a map")
        known = {state["entity_id"]: state for state in self._get("/api/states")}
        for entity in entities:
            self._look_for(entity, known, now.timestamp())
        with self._socket() as ask:
            self._read_states(ask, entities, begin, now)
            self._add_present(known)
            older = self._statistics(ask, begin)
        first_s = math.ceil(begin.timestamp() / self._every_s) * self._every_s
        grid_s = np.arange(first_s, now.timestamp(), self._every_s)
        grid_s = np.append(grid_s, now.timestamp())
        silent = _silences([states.at_s for states in self._seen.values()])
        words = {one.entity: {text: key for key, text in one.options.items()} for one in self._actuators.values()}
        table = {}
        for column in self._columns:
            values = self._seen[column].values(words.get(_entity(column), {}), column)
            row = _held(grid_s, self._seen[column].at_s, values)
            for first_s, last_s in silent:
                row[(grid_s > first_s) & (grid_s < last_s)] = np.nan
            if column in older:
                first = self._seen[column].at_s[0] if self._seen[column].at_s.size else np.inf
                row = np.where(grid_s < first, _of_hours(grid_s, *older[column]), row)
            for first_s, last_s in self._away.get(_entity(column), ()):
                row[(grid_s >= first_s) & (grid_s < last_s)] = np.nan
            table[column] = row
        index = pd.DatetimeIndex(pd.to_datetime(grid_s, unit="s", utc=True).round("us"), name="time")
        out = pd.DataFrame(table, index=index)
        told = {one: self._unit_of(one, self._entities[_entity(one)].get("attributes", {})) for one in self._columns}
        out.attrs["units"] = {one: unit for one, unit in told.items() if isinstance(unit, str)}
        return out

    def forecast(self) -> pd.DataFrame | str:
        """See `Connection.forecast`."""
        return self._outlook.now()

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """See `Connection.write`; raises `PlantError` where an entity did not take its value, after all were tried."""
        problems = []
        native = all(value is None for value in levels.values())
        if self._watchdog is not None and not native:
            # First: what comes after may fail, and the timer gives back what was set before.
            self._service("timer", "start", {"entity_id": self._watchdog, "duration": _duration(seconds)})
            if self._state(self._watchdog)["state"] != "active":
                raise PlantError(f"{self._watchdog} did not start: nothing is set without a watchdog")
        for name, level in levels.items():
            try:
                self._set(self._actuators[name], level)
            except KeyError:
                raise ConfigError(f"connection home-assistant: actuators: none is given for '{name}'") from None
            except PlantError as error:
                problems.append(str(error))
        if problems:
            raise PlantError("; ".join(problems))
        if self._watchdog is not None and native:
            self._service("timer", "cancel", {"entity_id": self._watchdog})

    def put_back(self, held: Mapping[str, float]) -> None:
        """See `Connection`; the timer is ended, whose end would undo it."""
        for name, value in held.items():
            one = self._actuators[name]
            unknown = one.domain in _HOLDS_OPTION and float(value) not in one.options
            self._set(one, None if unknown else value)
        self.leave()

    def leave(self) -> None:
        """See `Connection`: the timer is ended, whose end would undo what people set."""
        if self._watchdog is not None:
            self._service("timer", "cancel", {"entity_id": self._watchdog})

    def present(self, names: Iterable[str]) -> dict[str, float]:
        """See `Connection`: what the entities hold, where they are there and hold a number or a known option."""
        held = {}
        for name in names:
            one = self._actuators[name]
            state = self._state(one.entity)
            attributes = state["attributes"]
            said = attributes.get("temperature") if one.domain in _HOLDS_TEMPERATURE else state["state"]
            if state["state"] in _GONE or said is None:
                continue
            by_option = {text: level for level, text in one.options.items()}
            value = by_option.get(str(said), SWITCH.get(str(said).lower()))
            if value is None:
                try:
                    value = float(said)
                except (TypeError, ValueError):
                    continue
                if one.domain in _HOLDS_NUMBER:
                    value = (
                        in_celsius(value) if one.scale == 1.0 and _is_temperature_F(attributes) else value / one.scale
                    )
                elif one.domain in _HOLDS_TEMPERATURE and self._in_fahrenheit():
                    value = in_celsius(value)
            held[name] = value
        return held

    def time_zone(self) -> str:
        """The zone of the home, as its core has it, '' where it says none; raises `PlantError`."""
        return str(self._get("/api/config").get("time_zone", ""))

    def close(self) -> None:
        """See `Connection.close`."""
        self._session.close()

    def _set(self, actuator: HomeAssistantActuator, level: float | None) -> None:
        entity, state = actuator.entity, self._state(actuator.entity)
        if state["state"] in _GONE:
            raise PlantError(f"{entity} is {state['state']}: nothing was set")
        if actuator.domain in _HOLDS_TEMPERATURE and state["state"] == "off" and level is not None:
            raise PlantError(f"{entity} is off, so that a set-point does nothing: switch it to heat there")
        if actuator.domain in _HOLDS_TEMPERATURE and _is_range(state["attributes"]):
            raise PlantError(f"{entity} is in {state['state']}, of two set-points: switch it to heat there")
        target = self._target(actuator, level, state["attributes"])
        self._service(actuator.domain, target.service, {"entity_id": entity, **target.data})
        until = time.monotonic() + TAKEN_S
        while True:
            state = self._state(entity)
            held = state["state"] if target.attribute is None else state["attributes"].get(target.attribute)
            if _same(held, target):
                return
            if time.monotonic() > until:
                raise PlantError(f"{entity} was set to {target.value} but says {held}: is its device there?")
            time.sleep(_LOOK_S)

    def _target(self, actuator: HomeAssistantActuator, level: float | None, attributes: Mapping[str, Any]) -> _Target:
        value = actuator.release if level is None else level
        domain, entity = actuator.domain, actuator.entity
        if domain in _HOLDS_SWITCH:
            on = bool(value) if level is None else level >= 0.5
            return _Target("turn_on" if on else "turn_off", {}, None, "on" if on else "off", 0.0)
        if domain in _HOLDS_OPTION:
            option = str(value) if level is None else actuator.options.get(float(level))
            offered = attributes.get("options", [])
            if option is None or option not in offered:
                raise PlantError(f"{entity} has no option for {value}: it has {', '.join(offered)}; see key options")
            return _Target("select_option", {"option": option}, None, option, 0.0)
        number = float(value)
        least, most, step = (attributes.get(key) for key in ("min", "max", "step"))
        if domain in _HOLDS_TEMPERATURE:
            least, most, step = (attributes.get(key) for key in ("min_temp", "max_temp", "target_temp_step"))
            # Its API has the unit of the house; what is given back is written as the entity has it.
            if level is not None and self._in_fahrenheit():
                number = in_fahrenheit(number)
        elif level is not None:
            unit, plain = attributes.get("unit_of_measurement"), actuator.scale == 1.0
            if plain and unit == "%" and 0.0 < level <= 1.0:
                raise PlantError(
                    f"{entity} is in %, and {level:g} is a share: set scale: 100, in connection.yaml: nothing was set"
                )
            if plain and unit == "°F":
                if not _is_temperature_F(attributes):
                    raise PlantError(
                        f"{entity} is in °F, with a least value of {least}: a temperature, or a change of one? Give "
                        f"that of a temperature a least value of {_LEAST_TEMPERATURE_F:g} or more in Home Assistant, "
                        "and that of a change scale: 1.8 in connection.yaml: nothing was set"
                    )
                number = in_fahrenheit(number)
            number *= actuator.scale
        if not math.isfinite(number):
            raise PlantError(f"{entity}: {number} is no value")
        if step:
            steps = number / float(step)
            number = round(round(steps) * float(step), 6)
            if level is not None and abs(steps - round(steps)) > _ANOTHER_STEP and entity not in self._rounded:
                self._rounded.add(entity)
                told = f"{steps * float(step):g} is set as {number:g}"
                _LOG.warning("%s takes steps of %g: %s: see resolution of its command in the map", entity, step, told)
        number = round(number, 6)
        if (least is not None and number < float(least) - 1e-6) or (most is not None and number > float(most) + 1e-6):
            raise PlantError(
                f"{entity} takes {least} to {most}, not {number:g}: set minimum and maximum of its command in the map"
            )
        if domain in _HOLDS_TEMPERATURE:
            return _Target("set_temperature", {"temperature": number}, "temperature", number, 0.5 * float(step or 0.1))
        return _Target("set_value", {"value": number}, None, number, 0.5 * float(step or 0.01))

    def _unit_of(self, column: str, attributes: Mapping[str, Any]) -> Any:
        """The unit of an entity, or of an attribute: those of a climate have the unit of the house, and say none."""
        attribute = _attribute(column)
        if attribute is None:
            return attributes.get("unit_of_measurement")
        if attribute in _IN_PERCENT:
            return "%"
        if attribute not in _TEMPERATURES:
            return None
        own = attributes.get("temperature_unit")  # of a weather entity
        return own or (self._unit_of_house() if column.partition(".")[0] in _HOLDS_TEMPERATURE else None)

    def _unit_of_house(self) -> str:
        return str(self._get("/api/config")["unit_system"]["temperature"])

    def _in_fahrenheit(self) -> bool:
        return self._unit_of_house() == "°F"

    def _read_states(self, ask: _Ask, entities: list[str], begin: datetime, now: datetime) -> None:
        """Add to what is known of states what came since."""
        last_s = min((self._seen[c].until_s for c in self._columns if c in self._seen), default=0.0)
        at = begin if set(self._columns) - set(self._seen) else datetime.fromtimestamp(last_s - _AGAIN_S, UTC)
        pieces: dict[str, list[tuple[float, Any]]] = {column: [] for column in self._columns}
        asked_s = at.timestamp()
        while at < now:
            end = min(at + _PIECE, now)
            answer = ask(
                "history/history_during_period", start_time=at.isoformat(), end_time=end.isoformat(),
                entity_ids=entities, significant_changes_only=False, minimal_response=False, no_attributes=False,
            )  # fmt: skip
            for column in self._columns:
                entity, attribute = _entity(column), _attribute(column)
                for row in answer.get(entity, ()):
                    gone = row["s"] in _GONE or attribute is None
                    said = row["s"] if gone else row.get("a", {}).get(attribute)
                    pieces[column].append((max(float(row["lu"]), at.timestamp()), said))
            at = end
        for column, rows in pieces.items():
            before = self._seen.get(column, _States())
            self._seen[column] = before.with_later(asked_s, rows, now.timestamp(), begin.timestamp())

    def _look_for(self, entity: str, known: Mapping[str, Mapping[str, Any]], now_s: float) -> None:
        """Note whether an entity is among those `known`; raises `PlantError` where it never was.

        It may come later than others when Home Assistant starts, or have been renamed, which costs what it measures.
        """
        times = self._away.get(entity, [])
        away = bool(times) and math.isinf(times[-1][1])
        if entity in known:
            self._entities[entity] = known[entity]
            if away:
                times[-1] = (times[-1][0], now_s)
                _LOG.info("Home Assistant has entity '%s' again", entity)
            return
        hint = suggestion(entity, list(known))
        if entity not in self._entities:
            raise PlantError(f"Home Assistant has no entity '{entity}'{hint}")
        if not away:
            self._away.setdefault(entity, []).append((now_s, math.inf))
            _LOG.warning(
                "Home Assistant has no entity '%s' any more%s: what it measures is unknown until it is back; "
                "if it was renamed, name it in the map and start again",
                entity, hint,
            )  # fmt: skip

    def _add_present(self, known: Mapping[str, Mapping[str, Any]]) -> None:
        """Add what the entities say now: the recorder may be some seconds behind."""
        for column, states in self._seen.items():
            if _entity(column) not in known:
                continue
            state, attribute = known[_entity(column)], _attribute(column)
            at_s = datetime.fromisoformat(state["last_updated"]).timestamp()
            if not states.at_s.size and at_s < time.time() - _RECORDED_S:
                raise PlantError(f"Home Assistant keeps no history of '{_entity(column)}': see its recorder")
            if not states.at_s.size or at_s > states.at_s[-1]:
                gone = state["state"] in _GONE or attribute is None
                said = state["state"] if gone else state["attributes"].get(attribute)
                self._seen[column] = _States(np.append(states.at_s, at_s), (*states.said, said), states.until_s)

    def _statistics(self, ask: _Ask, begin: datetime) -> dict[str, tuple[Array, Array]]:
        """Hourly means from `begin` to the first state, of those that have them: middles of hours, s, and values."""
        own = [one for one in self._columns if _attribute(one) is None and self._seen[one].at_s.size]
        firsts = {column: self._seen[column].at_s[0] for column in own}
        wanted = [column for column, first in firsts.items() if first > begin.timestamp() + 3600.0]
        if not wanted:
            return {}
        end = datetime.fromtimestamp(max(firsts[column] for column in wanted), UTC)
        answer = ask(
            "recorder/statistics_during_period", start_time=begin.isoformat(), end_time=end.isoformat(),
            statistic_ids=wanted, period="hour", types=["mean", "state"],
        )  # fmt: skip
        return {column: whole_hours(answer[column]) for column in wanted if answer.get(column)}

    @contextmanager
    def _socket(self) -> Iterator[_Ask]:
        try:
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        except ModuleNotFoundError as error:
            raise ConfigError(
                "connection home-assistant needs websockets: pip install 'thermoforce-mpc[home]'"
            ) from error
        address = f"ws{self._url.removeprefix('http')}/api/websocket"
        if self._url.endswith("/core"):  # the supervisor's
            address = f"ws{self._url.removeprefix('http')}/websocket"
        try:
            with connect(
                address, open_timeout=_TIMEOUT_S, close_timeout=1.0, max_size=_MOST_BYTES, proxy=None
            ) as socket:
                socket.recv(timeout=_TIMEOUT_S)
                socket.send(json.dumps({"type": "auth", "access_token": self._token}))
                if json.loads(socket.recv(timeout=_TIMEOUT_S))["type"] != "auth_ok":
                    raise PlantError(f"{self._url} does not accept the token")
                numbers = count(1)

                def ask(kind: str, **parameters: Any) -> dict[str, Any]:
                    number = next(numbers)
                    socket.send(json.dumps({"id": number, "type": kind, **parameters}))
                    while True:
                        answer = json.loads(socket.recv(timeout=4 * _TIMEOUT_S))
                        if answer.get("id") == number and answer.get("type") == "result":
                            break
                    if not answer["success"]:
                        raise PlantError(f"{self._url}: {kind}: {answer.get('error', {}).get('message')}")
                    result: dict[str, Any] = answer["result"]
                    return result

                yield ask
        except OSError as error:
            raise not_reached(self._url, "url", error) from error
        except (WebSocketException, ValueError, KeyError) as error:
            raise PlantError(f"{self._url}: {type(error).__name__}: {error}") from error

    def _state(self, entity: str) -> dict[str, Any]:
        state: dict[str, Any] = self._get(f"/api/states/{entity}")
        return state

    def _get(self, path: str) -> Any:
        return self._request("GET", path, None)

    def _service(self, domain: str, service: str, data: Mapping[str, Any]) -> None:
        self._request("POST", f"/api/services/{domain}/{service}", data)

    def _request(self, method: str, path: str, data: Mapping[str, Any] | None) -> Any:
        try:
            answer = self._session.request(
                method, self._url + path, json=data, timeout=_TIMEOUT_S, allow_redirects=False,
                headers={"Authorization": f"Bearer {self._token}"},
            )  # fmt: skip
        except requests.RequestException as error:
            raise not_reached(self._url, "url", error) from error
        if answer.status_code == 401:
            raise PlantError(f"{self._url} does not accept the token")
        if answer.status_code == 404 and path.startswith("/api/states/"):
            raise PlantError(f"Home Assistant has no entity '{path.rpartition('/')[2]}'")
        if answer.status_code != 200:
            asked = f" for {json.dumps(data)}" if data else ""
            raise PlantError(f"{self._url}{path}{asked}: status {answer.status_code}, {answer.text[:200].strip()}")
        try:
            return answer.json()
        except ValueError as error:
            raise PlantError(f"{self._url}{path}: its answer is no JSON") from error


class _Ask(Protocol):
    """Type of the function that asks over the WebSocket."""

    def __call__(self, kind: str, **parameters: Any) -> dict[str, Any]:
        """The result."""


class _States(NamedTuple):
    """States of an entity or attribute: from when each held, s, and what was said; known until `until_s`."""

    at_s: Array = np.empty(0)
    said: tuple[Any, ...] = ()
    until_s: float = 0.0

    def with_later(self, from_s: float, rows: list[tuple[float, Any]], until_s: float, begin_s: float) -> _States:
        """With `rows` in the place of what is known from `from_s` on, without what was before `begin_s`."""
        kept = [(at, said) for at, said in zip(self.at_s.tolist(), self.said, strict=True) if at < from_s]
        kept += sorted(rows, key=lambda row: row[0])
        first = next((k for k, row in enumerate(kept) if row[0] >= begin_s), len(kept))
        kept = kept[max(first - 1, 0) :]
        return _States(np.array([at for at, _ in kept]), tuple(said for _, said in kept), until_s)

    def values(self, words: Mapping[str, float], column: str) -> Array:
        """As numbers (n,), NaN where it was unavailable; raises `PlantError` where it mostly says other words."""
        out, told, others = np.full(len(self.said), np.nan), None, 0
        for k, said in enumerate(self.said):
            text = str(said).strip().lower()
            if said is None or text in _GONE:
                continue
            found = words.get(str(said), SWITCH.get(text, _ACTIONS.get(text)))
            if found is None:
                try:
                    found = float(text)
                except ValueError:
                    told, others = said, others + 1
                    continue
            out[k] = found if math.isfinite(found) else np.nan
        if 2 * others > np.isfinite(out).sum():
            raise PlantError(f"'{column}' holds no number, but {told!r}: name another entity, or one of its attributes")
        return out


def _held(grid_s: Array, at_s: Array, values: Array) -> Array:
    """`values` (n,) from `at_s` (n,) on, at `grid_s` (m,); NaN before the first."""
    place = np.searchsorted(at_s, grid_s, side="right") - 1
    return np.where(place >= 0, values[np.maximum(place, 0)], np.nan)


def _silences(times: list[Array]) -> list[tuple[float, float]]:
    """From when to when nothing was stored of anything, though it usually is, s; a silence that lasts is none yet."""
    at = np.unique(np.concatenate(times)) if times else np.empty(0)
    between = np.diff(at)
    if between.size < 100:
        return []
    longest = max(_SILENCE * float(np.quantile(between, 0.99)), _SILENCE_S)
    return [(float(at[k]), float(at[k + 1])) for k in np.flatnonzero(between > longest)]


def whole_hours(rows: list[dict[str, Any]]) -> tuple[Array, Array]:
    """Middles of hours (n,), s, and their means of long-term statistics, without those beside a missing hour.

    In such an hour an outage began or ended, and the mean holds the value before it through: it was not measured. A
    counter has no mean: its state at the end of the hour.
    """
    start_s = np.array([row["start"] / 1000.0 for row in rows])
    counter = all(row.get("mean") is None for row in rows)
    values = np.array([row.get("state" if counter else "mean") for row in rows], dtype=np.float64)
    follows = np.diff(start_s) <= 3600.0 + 1.0
    keep = np.r_[True, follows] & np.r_[follows, True]
    middle_s = start_s + (3600.0 if counter else 1800.0)
    return middle_s[keep], values[keep]


def _of_hours(grid_s: Array, middle_s: Array, values: Array) -> Array:
    """Straight between the middles of hours that follow one another, at `grid_s` (n,); else NaN."""
    if middle_s.size < 2:
        return np.full(grid_s.size, np.nan)
    out = np.interp(grid_s, middle_s, values, left=np.nan, right=np.nan)
    place = np.clip(np.searchsorted(middle_s, grid_s), 1, middle_s.size - 1)
    return np.where(middle_s[place] - middle_s[place - 1] <= 3601.0, out, np.nan)


def _is_temperature_F(attributes: Mapping[str, Any]) -> bool:
    """Whether a number is a temperature in °F, and not a change of one, by its unit and least value."""
    least = attributes.get("min")
    return attributes.get("unit_of_measurement") == "°F" and least is not None and float(least) >= _LEAST_TEMPERATURE_F


def _is_range(attributes: Mapping[str, Any]) -> bool:
    return attributes.get("temperature") is None and attributes.get("target_temp_low") is not None


def _same(held: Any, target: _Target) -> bool:
    if isinstance(target.value, str):
        return bool(held == target.value)
    try:
        return abs(float(held) - target.value) <= target.tolerance + 1e-9
    except (TypeError, ValueError):
        return False


def _entity(column: str) -> str:
    return ".".join(column.split(".")[:2])


def _attribute(column: str) -> str | None:
    parts = column.split(".")
    return parts[2] if len(parts) > 2 else None


def _duration(seconds: float) -> str:
    whole = math.ceil(seconds)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def _check(name: str, one: HomeAssistantActuator) -> None:
    where = f"connection home-assistant: actuators.{name}"
    if one.domain not in _SETTABLE or "." not in one.entity:
        raise ConfigError(f"{where}.entity: {one.entity!r} cannot be set: expected one of {', '.join(_SETTABLE)}")
    numeric = isinstance(one.release, float | int) and not isinstance(one.release, bool)
    if one.domain in (*_HOLDS_TEMPERATURE, *_HOLDS_NUMBER) and not numeric:
        raise ConfigError(f"{where}.release: {one.release!r}: expected a number, in the unit of {one.entity}")
    if one.domain in _HOLDS_SWITCH and not isinstance(one.release, bool):
        raise ConfigError(f"{where}.release: {one.release!r}: expected true or false")
    if one.domain in _HOLDS_OPTION and (not isinstance(one.release, str) or not one.options):
        raise ConfigError(f"{where}: give release as one of its options, and options as {{1: blocked, 2: normal}}")
