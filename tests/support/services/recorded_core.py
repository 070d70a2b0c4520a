"""Answers of a real Home Assistant core, recorded between it and a connection, and served again on loopback."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import struct
import threading
import time
from contextlib import contextmanager
from datetime import datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

_STAMP = re.compile(r"^\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}")
# Times of the WebSocket's answers, s and ms.
_TIMES = {"lu": 1.0, "lc": 1.0, "start": 1000.0, "end": 1000.0}
_ASKED = ("start_time", "end_time", "id")


def key_of(message: dict) -> str:
    """A request of the WebSocket without its number and times."""
    return json.dumps({key: value for key, value in message.items() if key not in _ASKED}, sort_keys=True)


class Recorder:
    """Keeps what passes: REST by method, path and body, the WebSocket by what is asked."""

    def __init__(self) -> None:
        self.exchanges: list[dict] = []

    def rest(self, method, path, body, status, text) -> None:
        asked = f"{method} {path} {json.dumps(body, sort_keys=True) if body is not None else ''}".strip()
        self.exchanges.append({"at": time.time(), "asked": asked, "status": status, "text": text})

    def socket(self, message, answer) -> None:
        self.exchanges.append({"at": time.time(), "asked": key_of(message), "answer": answer})


def shifted(value, by_s: float):
    """`value` with every time in it moved."""
    if isinstance(value, dict):
        return {
            key: one + by_s * _TIMES[key] if key in _TIMES and isinstance(one, int | float) else shifted(one, by_s)
            for key, one in value.items()
        }
    if isinstance(value, list):
        return [shifted(one, by_s) for one in value]
    if isinstance(value, str) and _STAMP.match(value) and value[-6] in "+-":
        return (datetime.fromisoformat(value) + timedelta(seconds=by_s)).isoformat()
    return value


@contextmanager
def served(exchanges: list[dict], token: str):
    """The address of a server that answers as recorded, each question's answers in order, the last one again."""
    answers: dict[str, list[dict]] = {}
    for one in exchanges:
        answers.setdefault(one["asked"], []).append(one)
    by_s = time.time() - max(one["at"] for one in exchanges)

    def answer(asked: str) -> dict:
        queue = answers.get(asked)
        if queue is None:
            raise KeyError(f"nothing recorded for {asked}")
        return queue.pop(0) if len(queue) > 1 else queue[0]

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self):
            if self.headers.get("Upgrade", "").lower() == "websocket":
                return self._socket()
            return self._rest("GET")

        def do_POST(self):
            self._rest("POST")

        def _rest(self, method):
            length = int(self.headers.get("Content-Length") or 0)
            body = json.loads(self.rfile.read(length)) if length else None
            if self.headers.get("Authorization") != f"Bearer {token}":
                status, text = 401, "401: Unauthorized"
            else:
                asked = f"{method} {self.path} {json.dumps(body, sort_keys=True) if body is not None else ''}".strip()
                try:
                    one = answer(asked)
                    status, text = one["status"], one["text"]
                except KeyError as error:
                    status, text = 599, str(error)
                if status == 200:
                    text = json.dumps(shifted(json.loads(text), by_s))
            content = text.encode()
            self.send_response(status)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def _socket(self):
            key = self.headers["Sec-WebSocket-Key"] + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
            self.send_response(101)
            self.send_header("Upgrade", "websocket")
            self.send_header("Connection", "Upgrade")
            self.send_header("Sec-WebSocket-Accept", base64.b64encode(hashlib.sha1(key.encode()).digest()).decode())
            self.end_headers()
            self.close_connection = True
            self._say({"type": "auth_required"})
            if (self._hear() or {}).get("access_token") != token:
                return self._say({"type": "auth_invalid", "message": "Invalid access token or password"})
            self._say({"type": "auth_ok"})
            while (message := self._hear()) is not None:
                recorded = shifted(answer(key_of(message))["answer"], by_s)
                self._say({**recorded, "id": message["id"]})
            return None

        def _say(self, message):
            content = json.dumps(message).encode()
            size = len(content)
            head = (
                bytes([size])
                if size < 126
                else b"\x7e" + struct.pack(">H", size)
                if size < 65536
                else (b"\x7f" + struct.pack(">Q", size))
            )
            self.wfile.write(b"\x81" + head + content)
            self.wfile.flush()

        def _hear(self):
            head = self.rfile.read(2)
            if len(head) < 2 or head[0] & 15 == 8:
                return None
            size = head[1] & 127
            if size >= 126:
                size = int.from_bytes(self.rfile.read(2 if size == 126 else 8), "big")
            mask = self.rfile.read(4)
            return json.loads(bytes(b ^ mask[k % 4] for k, b in enumerate(self.rfile.read(size))))

        def log_message(self, *words):
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
