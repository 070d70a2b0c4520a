"""Download of the weather year of the BOPTEST test case; the only module of the package that needs a network."""

from __future__ import annotations

from pathlib import Path

import requests

from thermoforce_mpc.boundary.weather.readers import load_weather
from thermoforce_mpc.errors import WeatherError
from thermoforce_mpc.files import storage_errors, written

FILE_NAME = "Brussels.mos"
# Copy in the IDEAS library at a fixed commit; its values are checked as well. Other copies (one more there, one in
# another BOPTEST test case) lack the row of 1 January 01:00.
URL = (
    "https://raw.githubusercontent.com/open-ideas/IDEAS/767bfedefd296b7fb9e319d367dfaacaacd09a95"
    "/IDEAS/Resources/weatherdata/Brussels.mos"
)
FINGERPRINT = "7856f6e4b8b7"
_TIMEOUT_S = 30.0
_MOST_BYTES = 5_000_000


def fetch_brussels(folder: Path, url: str = URL, fingerprint: str = FINGERPRINT) -> Path:
    """The path of the Brussels weather year in `folder`, downloaded if missing; its values are always checked.

    The file is ASHRAE's IWEC data, licensed for your own use, not for redistribution. Raises `WeatherError` without
    network, for unexpected content at `url` or another file of that name (no partial file is left), and `StorageError`.
    """
    path = Path(folder) / FILE_NAME
    if path.exists():
        if load_weather(path).fingerprint != fingerprint:
            raise WeatherError(f"{path}: is not the Brussels year of the test case; move the file and fetch again")
        return path
    content = _download(url)
    with storage_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    with written(path) as aside:
        aside.write_bytes(content)
        try:
            downloaded = load_weather(aside).fingerprint
        except WeatherError as error:
            raise WeatherError(f"{url}: did not answer with a weather file ({error})") from error
        if downloaded != fingerprint:
            raise WeatherError(f"{url}: holds another weather year ({downloaded}, expected {fingerprint})")
    return path


def _download(url: str) -> bytes:
    """Return the body at `url`; raises `WeatherError` beyond 5 MB or if the request fails."""
    try:
        with requests.get(url, timeout=_TIMEOUT_S, stream=True) as response:
            response.raise_for_status()
            content = bytearray()
            for chunk in response.iter_content(65536):
                content += chunk
                if len(content) > _MOST_BYTES:
                    raise WeatherError(f"{url}: more than {_MOST_BYTES} bytes, so not a weather file")
            return bytes(content)
    except requests.RequestException as error:
        raise WeatherError(
            f"{url}: cannot be fetched ({type(error).__name__}); with no network, copy {FILE_NAME} from a BOPTEST "
            "checkout or the IDEAS library and pass it with --weather, or use the synthetic year"
        ) from error
