"""A command sealed off: a network without a way out and with a name server of its own, and a home that is empty."""

from __future__ import annotations

import fcntl
import json
import os
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_UNSHARE = ("unshare", "--map-root-user", "--net", "--mount")


@dataclass(frozen=True)
class Sealed:
    """What a command did: exit code and output, `names` it asked for, and `files` that it left, from its folder."""

    code: int
    output: str
    names: tuple[str, ...]
    files: tuple[str, ...]


@cache
def can_trap_names() -> bool:
    """Whether this user may make a network of its own here (user namespaces are forbidden in some containers)."""
    try:
        probe = subprocess.run([*_UNSHARE, sys.executable, __file__, "--probe"], capture_output=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return probe.returncode == 0


def sealed(command: Sequence[str], folder: Path, *, timeout_s: float = 300.0, **environment: str) -> Sealed:
    """Run a command in `folder`/work, with home and temporary folder beside it; `files` are what these three hold.

    Where no network can be made, it runs in this one, and `names` is empty: see `can_trap_names`.
    """
    for name in ("work", "home", "tmp"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    own = {"HOME": str(folder / "home"), "TMPDIR": str(folder / "tmp"), "PATH": os.environ["PATH"]}
    own |= {key: os.environ[key] for key in ("PYTHONPATH", "OMP_NUM_THREADS") if key in os.environ} | environment
    names = folder / "names.json"
    if can_trap_names():
        command = [*_UNSHARE, sys.executable, __file__, str(names), *command]
    done = subprocess.run(
        command, cwd=folder / "work", env=own, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        timeout=timeout_s, check=False,
    )  # fmt: skip
    asked = json.loads(names.read_text()) if names.exists() else []
    files = [path for name in ("work", "home", "tmp") for path in sorted((folder / name).rglob("*"))]
    found = tuple(str(path.relative_to(folder)) for path in files if not path.is_dir())
    return Sealed(done.returncode, done.stdout, tuple(sorted(set(asked))), found)


def _inside(words: Sequence[str]) -> int:
    """In the new network: bring its loopback up, answer for its names, and run the command."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        up = struct.pack("16sh", b"lo", 0x1 | 0x40)  # IFF_UP, IFF_RUNNING
        fcntl.ioctl(any_socket, 0x8914, up)  # SIOCSIFFLAGS
    here = Path("/run/sealed")
    resolver = Path(os.path.realpath("/etc/resolv.conf"))
    # Other services that would answer for names have their sockets below /run.
    _mounted("-t", "tmpfs", "none", "/run")
    here.mkdir()
    if resolver.is_relative_to("/run"):
        resolver.parent.mkdir(parents=True, exist_ok=True)
        resolver.touch()
    for path, text in ((resolver, "nameserver 127.0.0.1\n"), (Path("/etc/nsswitch.conf"), "hosts: files dns\n")):
        if path.exists():
            (here / path.name).write_text(text)
            _mounted("--bind", str(here / path.name), str(path))
    asked: list[str] = []
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.bind(("127.0.0.1", 53))
    threading.Thread(target=_answer, args=(server, asked), daemon=True).start()
    if words == ["--probe"]:
        try:
            socket.getaddrinfo("sealed.test", 80)
        except socket.gaierror:
            return int(asked == [])
        return 1
    names, *command = words
    code = subprocess.run(command, check=False).returncode
    Path(names).write_text(json.dumps(asked))
    return code


def _mounted(*words: str) -> None:
    subprocess.run(["mount", *words], check=True)


def _answer(server: socket.socket, asked: list[str]) -> None:
    """A name server that notes each question, and answers that there is no such name."""
    while True:
        message, sender = server.recvfrom(4096)
        labels, at = [], 12
        while message[at]:
            labels.append(message[at + 1 : at + 1 + message[at]].decode("ascii", "replace"))
            at += 1 + message[at]
        asked.append(".".join(labels))
        # Query's number and question; flags: an answer, recursion available, NXDOMAIN.
        server.sendto(message[:2] + b"\x81\x83" + message[4:6] + b"\0" * 6 + message[12 : at + 5], sender)


if __name__ == "__main__":
    sys.exit(_inside(sys.argv[1:]))
