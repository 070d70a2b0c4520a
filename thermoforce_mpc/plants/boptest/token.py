"""Where BOPTEST_TOKEN may go: it belongs to the services that its owner named, not to one that a file names."""

from __future__ import annotations

import ipaddress
import json
import os
from urllib.parse import urlsplit

from thermoforce_mpc.data.cache import known_marks, note_marks
from thermoforce_mpc.errors import ConfigError


def allow_token(url: str) -> None:
    """Note that the user, not a file, named the service at `url` while BOPTEST_TOKEN was set."""
    if _has_token():
        note_marks([_mark(url)])


def check_token(url: str) -> None:
    """Raise `ConfigError` where BOPTEST_TOKEN would go to a service that neither user, BOPTEST_URL nor this host is."""
    if not _has_token() or _is_here(url):
        return
    if _mark(url) not in {_mark(os.environ.get("BOPTEST_URL", "")), *known_marks()}:
        raise ConfigError(
            f"plant.url: {url} is named by a file, and BOPTEST_TOKEN would go there. Where it was set for that "
            f"service, give --url {url} once or set BOPTEST_URL; else unset BOPTEST_TOKEN"
        )


def _has_token() -> bool:
    return bool(os.environ.get("BOPTEST_TOKEN", "").strip())


def _mark(url: str) -> str:
    """Scheme, host and port: paths of one host share its token."""
    parts = urlsplit(url)
    port = parts.port or {"http": 80, "https": 443}.get(parts.scheme)
    return json.dumps(["token", f"{parts.scheme}://{parts.hostname}:{port}"])


def _is_here(url: str) -> bool:
    host = urlsplit(url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
