"""The page of a running controller, in a process of its own: it reads what the controller writes, and what people ask
by it goes into their file. It ends with the controller; whatever ends it before, or makes it fail, ends no control.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import pandas as pd

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError, PlantError, ThermoForceError
from thermoforce_mpc.execution.progress import duration
from thermoforce_mpc.files import is_loopback, read_json, secret_from
from thermoforce_mpc.records.journal import NAME
from thermoforce_mpc.records.people import KEYS, SHOWN, People
from thermoforce_mpc.records.run_folder import MOST_BYTES, saving_so_far
from thermoforce_mpc.report.live_view import LiveRun

_LOG = logging.getLogger(__name__)
TOKEN = "TF_MPC_PAGE_TOKEN"
"""Variable of the environment for the token of the page."""
_INGRESS, _INGRESS_PORT = "ingress", 8099
# How long until a page that ended is started again, at first and at most; until a journal that cannot be read is tried
# again; and for the end of the process, s.
_AGAIN_S, _LATER_S, _ANEW_S, _END_S = 2.0, 60.0, 30.0, 5.0
# Decisions are late after so many steps and s: in a step, and its delay, none is due.
_LATE_STEPS, _LATE_S = 2, 600.0
# Of the environment; tokens of connections are not for the page.
_ENVIRONMENT = ("HOME", "LANG", "PATH", "TMPDIR", "TZ", "VIRTUAL_ENV")
# The loop goes first where both want the one core.
_NICE = 10


@dataclass(frozen=True)
class PageSettings:
    """Where the page is, for whom, and what it shows: the run in `folder`, whose times without an offset are of `zone`.

    `token`: what people log in with; '' where only this machine, or who comes through Home Assistant, reaches it.
    """

    folder: str
    host: str
    port: int
    zone: str | None = None
    token: str = ""
    names: tuple[str, ...] = ()
    ingress: bool = False

    @classmethod
    def of(
        cls, listen: str, folder: Path, zone: str | None, token_file: Path | None = None, names: tuple[str, ...] = ()
    ) -> PageSettings:
        """Settings for `listen`: HOST:PORT, or ingress[:PORT] within an add-on of Home Assistant.

        Raises:
            ConfigError: it is neither; others reach it and there is no token; the server is not installed.
        """
        try:
            from thermoforce_mpc.service.access import check_token
            from thermoforce_mpc.service.live_page import live_app  # noqa: F401
        except ModuleNotFoundError as error:
            raise ConfigError(
                f"--page needs {error.name}, which is not installed: pip install 'thermoforce-mpc[serve]'"
            ) from error
        host, _, text = listen.rpartition(":") if ":" in listen else (listen, "", str(_INGRESS_PORT))
        host = host.removeprefix("[").removesuffix("]")
        if not (text.isascii() and text.isdigit() and int(text) <= 65535 and host) or (
            host != _INGRESS and ":" not in listen
        ):
            raise ConfigError(f"--page {listen}: expected HOST:PORT, as 127.0.0.1:8010, or ingress")
        if host == _INGRESS:
            return cls(str(folder), "0.0.0.0", int(text), zone, names=names, ingress=True)
        token = ""
        if token_file is not None or os.environ.get(TOKEN, "").strip():
            token = secret_from(token_file, (TOKEN,), "--page-token-file")
        check_token(host, token or None, TOKEN)
        own = () if is_loopback(host) else (socket.gethostname(), f"{socket.gethostname()}.local")
        return cls(str(folder), host, int(text), zone, token, (*own, host, *names))

    @property
    def address(self) -> str:
        """Where a browser finds it, but for the port."""
        return f"[{self.host}]" if ":" in self.host else self.host


class Page:
    """The controller's side: starts the process, and starts it again after it ended."""

    def __init__(self, settings: PageSettings, say: Callable[[str], None] = lambda text: None) -> None:
        """`say`: is told where the page is."""
        self._settings, self._say = settings, say
        self._closed = threading.Event()
        self._process: subprocess.Popen[str] | None = None
        self._failed, self._ready = "", False
        self._thread = threading.Thread(target=self._keep_up, name="tf-mpc page", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        """Number of the process, while there is one."""
        return None if self._process is None else self._process.pid

    def close(self) -> None:
        """End the process."""
        self._closed.set()
        process = self._process
        if process is not None:
            with suppress(OSError):
                process.kill()  # it holds nothing that has to be ended in order
        self._thread.join(_END_S)

    def _keep_up(self) -> None:
        again_s = _AGAIN_S
        while not self._closed.is_set():
            self._ready = False
            try:
                last = self._run()
            except Exception as error:  # a page is no reason to end a control
                last = f"{type(error).__name__}: {error}"
            again_s = _AGAIN_S if self._ready else min(2.0 * again_s, _LATER_S)
            if not self._closed.is_set() and last != self._failed:
                _LOG.warning("the page ended (%s), and is started again; control goes on", last)
                self._failed = last
            self._closed.wait(again_s)

    def _run(self) -> str:
        """Start the process and wait for its end; the last that it said."""
        last = "it said nothing"
        with subprocess.Popen(
            [sys.executable, "-P", "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C is the controller's to answer
            env={
                key: value
                for key, value in os.environ.items()
                if key in _ENVIRONMENT or key.startswith(("LC_", "PYTHON"))
            },
        ) as process:
            self._process = process
            if self._closed.is_set():
                process.kill()
            assert process.stdin is not None
            assert process.stdout is not None
            # Not as an argument, which others see. The end of the pipe tells the page that we are gone.
            process.stdin.write(json.dumps(asdict(self._settings)) + "\n")
            process.stdin.flush()
            for line in process.stdout:
                last = line.strip()[:500] or last
                if last.startswith("port "):
                    self._ready, self._failed = True, ""
                    at = f"http://{self._settings.address}:{last.removeprefix('port ')}/"
                    self._say("Page: behind Home Assistant" if self._settings.ingress else f"Page: {at}")
        self._process = None
        return last


class _Shows:
    """What the page shows, and who hears it: of the folder of a run."""

    def __init__(self, folder: Path, zone: str | None) -> None:
        self._folder = folder
        self._people = People(folder / "people.json", zone)
        self._live: LiveRun | None = None
        self._why, self._from_s = "", 0.0

    def view(self) -> Mapping[str, Any]:
        """See `live_app`: the view of `tf-mpc watch`, with commands, saving and mode."""
        more, view = self._decided(), self._journal()
        told = {"saving": saving_so_far(self._folder).get("said", ""), "mode": more["mode"]}
        return view | told | {"commands": more["commands"], "late": _late(view, pd.Timestamp.now("UTC"))}

    def shown(self) -> Mapping[str, Any]:
        """See `Hears.shown`."""
        now, wishes, more = pd.Timestamp.now("UTC"), self._people.wishes(), self._decided()
        shown = self._people.shown(now)
        asks = [key for key in KEYS if key in more["asks"]]
        return shown | {
            "asks": asks,
            "mode": shown["mode"] if "mode" in asks else more["mode"],
            "away_until": wishes.away_until if shown["away"] else None,
            "comfort_until": wishes.comfort_until if (shown["lower_C"] or shown["upper_C"]) else None,
        }

    def ask(self, key: str, text: str) -> None:
        """See `Hears.ask`."""
        if key != "comfort" and key not in self.shown()["asks"]:
            raise ConfigError(f"{key!r} cannot be asked of this controller now")
        self._people.ask(key, text, pd.Timestamp.now("UTC"))

    def _decided(self) -> dict[str, Any]:
        """Mode and commands of what was decided last, and what may be asked, as the controller wrote it."""
        try:
            of = read_json(self._folder / SHOWN, MOST_BYTES)
        except InputError:
            of = {}
        plan, asks = of.get("plan"), of.get("asks")
        rows = plan.get("commands") if isinstance(plan, dict) else None
        return {
            "mode": str(of.get("mode", "")),
            "asks": asks if isinstance(asks, list) else [],
            "commands": [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else [],
        }

    def _journal(self) -> dict[str, Any]:
        """The view of the journal; one that cannot be read is tried again after a while, from its beginning."""
        if self._live is None and time.monotonic() < self._from_s:
            raise InputError(self._why)
        try:
            self._live = self._live or LiveRun(self._folder)
            return self._live.now().to_json()
        except ThermoForceError as error:
            none = not (self._folder / NAME).exists() or "no step was decided yet" in str(error)
            self._live, self._why = None, "nothing is decided yet: the first step is waited for" if none else str(error)
            self._from_s = time.monotonic() + (0.0 if none else _ANEW_S)
            raise InputError(self._why) from error


def _late(view: Mapping[str, Any], now: pd.Timestamp) -> str:
    """Since when nothing is decided, where that is long ago for a controller that runs; else ''."""
    if view["state"] != "running" or not view["zone"]:
        return ""
    ends = [view["time_s"], *(point["time_s"] for point in view["plan"])]
    step_s = min((end - begin for begin, end in pairwise(ends)), default=HOUR_S)
    late_s = (now - pd.Timestamp(view["origin"])).total_seconds() - view["time_s"]
    return f"nothing was decided for {duration(late_s)}" if late_s > _LATE_STEPS * step_s + _LATE_S else ""


def serve(told: IO[str]) -> None:
    """Serve the page of the settings in the first line of `told`, until it ends."""
    from thermoforce_mpc.service.live_page import PageAccess, page_server
    from thermoforce_mpc.service.server import effective_port

    with suppress(OSError):
        os.nice(_NICE)
    logging.getLogger("waitress").setLevel(logging.ERROR)
    told_settings = json.loads(told.readline())
    settings = PageSettings(**told_settings | {"names": tuple(told_settings["names"])})
    shows = _Shows(Path(settings.folder), settings.zone)
    access = PageAccess(settings.token or None, settings.names, settings.ingress, "--page-name")
    try:
        server = page_server(shows.view, settings.port, host=settings.host, hears=shows, access=access)
    except PlantError as error:
        print(str(error).replace("another --port", "another port in --page"), flush=True)
        raise SystemExit(1) from None

    def until_it_ends() -> None:
        told.read()
        os._exit(0)  # nothing is half done: what people ask is written whole or not at all

    threading.Thread(target=until_it_ends, daemon=True).start()
    print(f"port {effective_port(server)}", flush=True)
    server.run()


if __name__ == "__main__":
    serve(sys.stdin)
