"""A real MQTT broker (Debian's mosquitto) on loopback, with password and TLS, and a wire to it that can be cut."""

from __future__ import annotations

import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

USER, PASSWORD = "house", "not-a-secret"


def missing() -> str:
    """Why there is no broker, or nothing."""
    if shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin") is None:
        return "mosquitto is not installed (apt-get install mosquitto)"
    return "" if shutil.which("openssl") else "openssl is not installed"


class Broker:
    """A broker that keeps nothing but its retained messages; `stop`, `start` again on the same ports."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self.port, self.tls_port = _free_port(), _free_port()
        _certificates(folder)
        passwords = folder / "passwords"
        subprocess.run(
            ["mosquitto_passwd", "-b", "-c", str(passwords), USER, PASSWORD], check=True, capture_output=True
        )
        self.password_file = folder / "password"
        self.password_file.write_text(PASSWORD)
        for path in (passwords, self.password_file):
            path.chmod(0o600)
        (folder / "mosquitto.conf").write_text(
            f"per_listener_settings false\nallow_anonymous false\npassword_file {passwords}\nuser root\n"
            f"persistence true\npersistence_location {folder}/\n"
            f"listener {self.port} 127.0.0.1\n"
            f"listener {self.tls_port} 127.0.0.1\ncertfile {folder}/server.crt\nkeyfile {folder}/server.key\n"
        )

    def start(self) -> None:
        """Start it, on the same ports as before."""
        mosquitto = str(shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin"))
        self._process = subprocess.Popen(
            [mosquitto, "-c", str(self.folder / "mosquitto.conf")], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for _ in range(500):
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.tls_port), 1.0):
                return
            time.sleep(0.01)
        raise RuntimeError("mosquitto did not start")

    def stop(self) -> None:
        """End it; what it keeps stays kept."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait(10)
            self._process = None

    def options(self, **more: Any) -> dict[str, Any]:
        """Options of a connection to it."""
        return {"host": "127.0.0.1", "port": self.port, "user": USER, "password_file": str(self.password_file), **more}

    def client(self, **callbacks: Any) -> Any:
        """A connected client of somebody else."""
        import paho.mqtt.client as paho

        client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        client.username_pw_set(USER, PASSWORD)
        for name, function in callbacks.items():
            setattr(client, name, function)
        client.connect("127.0.0.1", self.port)
        client.loop_start()
        for _ in range(500):
            if client.is_connected():
                return client
            time.sleep(0.01)
        raise RuntimeError("no connection to the broker")


def subscribed(client: Any, topics: str) -> None:
    """Subscribe to `topics`, and wait until the broker has it: what is published before is not heard."""
    granted = threading.Event()
    client.on_subscribe = lambda *_: granted.set()
    client.subscribe(topics, 1)
    if not granted.wait(10.0):
        raise RuntimeError(f"the broker did not confirm the subscription of {topics}")


class Listener:
    """What is published below `topics`, as (topic, text, retained), to wait for."""

    def __init__(self, broker: Broker, topics: str = "#") -> None:
        self.heard: list[tuple[str, str, bool]] = []
        self._client = broker.client(on_message=self._on_message)
        subscribed(self._client, topics)

    def _on_message(self, client: Any, userdata: Any, message: Any) -> None:
        self.heard.append((message.topic, message.payload.decode(), bool(message.retain)))

    def texts(self, topic: str) -> list[str]:
        """What came on a topic."""
        return [text for where, text, _ in self.heard if where == topic]

    def wait(self, topic: str, count: int = 1, seconds: float = 10.0) -> list[str]:
        """`texts`, when there are so many, or after so long."""
        until = time.monotonic() + seconds
        while len(self.texts(topic)) < count and time.monotonic() < until:
            time.sleep(0.01)
        return self.texts(topic)

    def close(self) -> None:
        """End the connection."""
        self._client.disconnect()
        self._client.loop_stop()


@contextmanager
def wire(port: int) -> Iterator[tuple[int, threading.Event, Callable[[], None]]]:
    """A port that leads to `port` until `.set()`: then nothing passes, and nothing says so, as in a cut network.

    Its third value ends what is open, as when a process is killed.
    """
    server, cut = socket.create_server(("127.0.0.1", 0)), threading.Event()
    open_ones: list[socket.socket] = []

    def pump(source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                while cut.is_set():
                    time.sleep(0.01)
                target.sendall(data)
        for one in (source, target):
            with suppress(OSError):  # a close alone is not seen where another thread still reads
                one.shutdown(socket.SHUT_RDWR)
            with suppress(OSError):
                one.close()

    def accept() -> None:
        with suppress(OSError):
            while True:
                here, _ = server.accept()
                try:
                    there = socket.create_connection(("127.0.0.1", port))
                except OSError:
                    here.close()
                    continue
                open_ones.extend((here, there))
                for pair in ((here, there), (there, here)):
                    threading.Thread(target=pump, args=pair, daemon=True).start()

    def snap() -> None:
        for one in open_ones:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        open_ones.clear()

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield server.getsockname()[1], cut, snap
    finally:
        cut.clear()
        for one in (server, *open_ones):
            with suppress(OSError):
                one.close()


def _certificates(folder: Path) -> None:
    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)

    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
    openssl("req", "-x509", *curve, "-keyout", "ca.key", "-out", "ca.crt", "-days", "2", "-subj", "/CN=test authority")
    openssl("req", *curve, "-keyout", "server.key", "-out", "server.csr", "-subj", "/CN=localhost")
    (folder / "names").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
    openssl(
        "x509", "-req", "-in", "server.csr", "-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial", "-out",
        "server.crt", "-days", "2", "-extfile", "names",
    )  # fmt: skip


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
