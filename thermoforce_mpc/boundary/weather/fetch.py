"""Gets the weather of the BOPTEST test case for users who have a network; nothing else here needs one."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import requests

from thermoforce_mpc.boundary.weather.readers import load_weather
from thermoforce_mpc.errors import WeatherError

FILE_NAME = "Brussels.mos"
# The IDEAS library's copy, at a commit: the file cannot change under us, and its values are checked all the same. Not
# every copy will do: another one there, and one in a neighbouring test case, lacks the row of 1 January 01:00.
URL = (
    "https://raw.githubusercontent.com/open-ideas/IDEAS/767bfedefd296b7fb9e319d367dfaacaacd09a95"
    "/IDEAS/Resources/weatherdata/Brussels.mos"
)
FINGERPRINT = "7856f6e4b8b7"
_TIMEOUT_S = 30.0
_MOST_BYTES = 5_000_000


def fetch_brussels(folder: Path, url: str = URL, fingerprint: str = FINGERPRINT) -> Path:
    """The Brussels weather year in `folder`; downloaded when it is not there yet, checked in either case.

    The file is ASHRAE's IWEC data under its own licence: for your own use, not to be passed on.

    Raises:
        WeatherError: no network, not the file expected, or a file of that name in `folder` that is not it. Nothing is
            left half-written.
    """
    path = Path(folder) / FILE_NAME
    if path.exists():
        if load_weather(path).fingerprint != fingerprint:
            raise WeatherError(f"{path}: is not the Brussels year of the test case; move it away and fetch again")
        return path
    content = _download(url)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix="fetching-", suffix=".mos")
    except OSError as error:
        raise WeatherError(f"{path.parent}: cannot be written ({error})") from error
    partial = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        try:
            found = load_weather(partial).fingerprint
        except WeatherError as error:
            raise WeatherError(f"{url}: did not answer with a weather file ({error})") from error
        if found != fingerprint:
            raise WeatherError(f"{url}: holds another weather year ({found}, expected {fingerprint})")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return path


def _download(url: str) -> bytes:
    """The body at `url`, refused when it grows beyond any weather file."""
    try:
        with requests.get(url, timeout=_TIMEOUT_S, stream=True) as response:
            response.raise_for_status()
            content = bytearray()
            for chunk in response.iter_content(65536):
                content += chunk
                if len(content) > _MOST_BYTES:
                    raise WeatherError(f"{url}: more than {_MOST_BYTES} bytes, which is no weather file")
            return bytes(content)
    except requests.RequestException as error:
        raise WeatherError(
            f"{url}: cannot be fetched ({type(error).__name__}); with no network, copy {FILE_NAME} from a BOPTEST "
            "checkout or the IDEAS library and pass it with --weather, or use the synthetic year"
        ) from error
