"""Weather: Open-Meteo and MET Norway."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pandas as pd

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.protocols import Answer
from thermoforce_mpc.providers.service import OUTDOOR, SUN, Service, documented, expires, parsed, stamped


class OpenMeteo(Service):
    """Open-Meteo: every quarter of an hour, with irradiance; CC BY 4.0, without a key for non-commercial use"""

    attribution: ClassVar[str] = "Weather data by Open-Meteo.com (CC BY 4.0)"

    def __init__(
        self, latitude: float = float("nan"), longitude: float = float("nan"), url: str = "https://api.open-meteo.com"
    ) -> None:
        """Of a place.

        Args:
            latitude: °, north positive.
            longitude: °, east positive.
            url: its address, or that of a server of your own.
        """
        super().__init__(url)
        self._place = _place("open-meteo", latitude, longitude)

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """See `Provider`; irradiance is that of the instant, not the mean of the quarter before."""
        _, body, headers = self.get(
            "/v1/forecast",
            {
                "latitude": self._place[0], "longitude": self._place[1], "timezone": "GMT", "timeformat": "unixtime",
                "minutely_15": "temperature_2m,shortwave_radiation_instant", "past_days": 1, "forecast_days": 3,
            },
        )  # fmt: skip
        said = parsed(body, self.url)
        with documented(self.url):
            if said["utc_offset_seconds"] != 0:
                raise PlantError(f"{self.url}: times of another zone than UTC, which was asked for")
            unit, rows = said["minutely_15_units"]["temperature_2m"], said["minutely_15"]
            if unit != "°C":
                raise PlantError(f"{self.url}: temperatures in {unit}, not in °C")
            table = pd.DataFrame(
                {OUTDOOR: _numbers(rows["temperature_2m"]), SUN: _numbers(rows["shortwave_radiation_instant"])},
                index=pd.DatetimeIndex(pd.to_datetime(rows["time"], unit="s", utc=True)),
            )
        return Answer(table, fresh=expires(headers))


class MetNorway(Service):
    """MET Norway: hourly for two days, cloud cover to irradiance; CC BY 4.0 and NLOD 2.0, needs a contact"""

    attribution: ClassVar[str] = "Weather data by MET Norway (CC BY 4.0)"

    def __init__(
        self, latitude: float = float("nan"), longitude: float = float("nan"), contact: str = "",
        altitude_m: int | None = None, url: str = "https://api.met.no",
    ) -> None:  # fmt: skip
        """Of a place.

        Args:
            latitude: °, north positive; sent with four decimals, as its terms ask.
            longitude: °, east positive.
            contact: address or page by which its operators reach you; sent as User-Agent, which its terms ask for.
            altitude_m: of the house above the sea, m.
            url: its address.
        """
        super().__init__(url)
        self._place, self._altitude_m = _place("met-norway", latitude, longitude), altitude_m
        if "@" not in contact and "." not in contact:
            raise ConfigError("provider met-norway: contact: its terms ask for a mail address or page of yours")
        self._contact = contact

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """See `Provider`; asked with If-Modified-Since of the last answer, and not before it Expires."""
        headers = {"User-Agent": f"thermoforce-mpc {self._contact}"}
        if "last-modified" in state:
            headers["If-Modified-Since"] = state["last-modified"]
        place: dict[str, Any] = {"lat": f"{self._place[0]:.4f}", "lon": f"{self._place[1]:.4f}"}
        if self._altitude_m is not None:
            place["altitude"] = self._altitude_m
        status, body, told = self.get(
            "/weatherapi/locationforecast/2.0/compact", place, headers, accepted=(200, 203, 304)
        )
        kept = {key: told[key] for key in ("last-modified",) if key in told} or state
        if status == 304:
            return Answer(pd.DataFrame(), fresh=expires(told), state=kept, unchanged=True)
        said = parsed(body, self.url)
        with documented(self.url):
            properties = said["properties"]
            if properties["meta"]["units"]["air_temperature"] != "celsius":
                raise PlantError(f"{self.url}: temperatures not in celsius")
            rows = properties["timeseries"]
            index = stamped([row["time"] for row in rows], self.url)
            details = [row["data"]["instant"]["details"] for row in rows]
            T_out_C = _numbers([one["air_temperature"] for one in details])
            cloud = _numbers([one.get("cloud_area_fraction") for one in details])
        # Every quarter of an hour as far as it is hourly: the sun moves between two hours, clouds go straight.
        hourly = np.r_[True, np.diff(index.as_unit("s").asi8) <= 3600]
        last = int(np.argmin(hourly)) if not hourly.all() else len(index)
        fine = pd.date_range(index[0], index[last - 1], freq="15min") if last > 1 else index[:1]
        at_s, fine_s = (np.asarray(i.as_unit("s").asi8, dtype=np.float64) for i in (index, fine))
        table = pd.DataFrame(
            {
                OUTDOOR: np.interp(fine_s, at_s, T_out_C),
                SUN: clouded_W_m2(fine, np.interp(fine_s, at_s, cloud) / 100.0, *self._place),
            },
            index=fine,
        )
        return Answer(table, fresh=expires(told), state=kept)


def clouded_W_m2(at: pd.DatetimeIndex, cloud: Array, latitude: float, longitude: float) -> Array:
    """Global horizontal irradiance (n,), W/m², with the share `cloud` (n,) of the sky covered.

    Kasten and Czeplak (1980), Solar Energy 24, 177-189: clear sky times 1 − 0.75 N^3.4.
    """
    from thermoforce_mpc.boundary.weather.solar import clear_sky_W_m2, sun_position

    new_year = pd.Timestamp(year=at[0].year, month=1, day=1, tz="UTC")
    time_s = np.asarray((at - new_year) / pd.Timedelta(seconds=1), dtype=np.float64)
    clear = clear_sky_W_m2(sun_position(time_s, latitude, longitude, 0.0))
    return np.asarray(clear * (1.0 - 0.75 * np.clip(cloud, 0.0, 1.0) ** 3.4))


def _numbers(values: list[Any]) -> Array:
    return np.array([np.nan if value is None else float(value) for value in values], dtype=np.float64)


def _place(name: str, latitude: float, longitude: float) -> tuple[float, float]:
    if not (-90.0 <= latitude <= 90.0 and -180.0 <= longitude <= 180.0):
        raise ConfigError(f"provider {name}: give latitude and longitude, in °, of the house")
    return round(latitude, 4), round(longitude, 4)
