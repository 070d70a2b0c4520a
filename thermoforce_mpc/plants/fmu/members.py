"""Members of an FMU's zip file, read within bounds and never written outside of their folder.

An FMU is a program: whoever runs one trusts its author. Reading one, to see what it is, must not need that trust.
"""

from __future__ import annotations

import hashlib
import io
import re
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import read_bounded, read_pieces

# BOPTEST's test cases have 6 MB, 34 MB when unpacked, in 13 members.
_MOST_FILE_BYTES = 500_000_000
_MOST_UNPACKED_BYTES = 2_000_000_000
_MOST_MEMBERS = 20_000
_MOST_LIST_BYTES = 200 * _MOST_MEMBERS
_MOST_NAME = 1000
_KINDS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1


class Members:
    """Members of the zip file at `path` by name, after a check of their number, sizes and names.

    Raises `ConfigError` where the file is missing, no zip file, too large, or has a member that no FMU has.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        content = read_bounded(path, _MOST_FILE_BYTES, ConfigError)
        self.sha256 = hashlib.sha256(content).hexdigest()
        # Before the list is read: each of its entries costs ten times its size in memory.
        if _list_bytes(content) > _MOST_LIST_BYTES:
            raise ConfigError(f"{path}: not an FMU (its list of members is longer than {_MOST_LIST_BYTES:,} bytes)")
        with self._as_config_error():
            self._file = zipfile.ZipFile(io.BytesIO(content))
        self.names = tuple(self._file.namelist())
        if len(self.names) > _MOST_MEMBERS:
            raise ConfigError(f"{path}: {len(self.names):,} members; at most {_MOST_MEMBERS:,} are read")
        if len(set(self.names)) != len(self.names):
            raise ConfigError(f"{path}: two members have the same name")
        for member in self._file.infolist():
            self._check(member)
        unpacked = sum(member.file_size for member in self._file.infolist())
        if unpacked > _MOST_UNPACKED_BYTES:
            raise ConfigError(f"{path}: {unpacked:,} bytes when unpacked; at most {_MOST_UNPACKED_BYTES:,} are")

    def read(self, name: str, most_bytes: int) -> bytes:
        """Return the content of a member; raises `ConfigError` where it is damaged or longer than `most_bytes`."""
        size = self._file.getinfo(name).file_size
        if size > most_bytes:
            raise ConfigError(f"{self._path}: {name} has {size:,} bytes; at most {most_bytes:,} are read")
        with self._as_config_error(name), self._file.open(name) as member:
            return read_pieces(member, most_bytes)

    def unpack(self, folder: Path) -> None:
        """Write all members below `folder`; raises `ConfigError` if one is damaged or there is no room."""
        free = shutil.disk_usage(folder).free
        needed = sum(member.file_size for member in self._file.infolist())
        if needed > free:
            raise ConfigError(f"{self._path}: needs {needed:,} bytes in {folder}, which has {free:,}; set TMPDIR")
        with self._as_config_error():
            self._file.extractall(folder)

    def _check(self, member: zipfile.ZipInfo) -> None:
        name, where = member.filename, f"{self._path}: member {member.filename!r:.100}"
        pure = PurePosixPath(name)
        if pure.is_absolute() or ".." in pure.parts or re.search(r"[\\:\x00-\x1f]", name) or len(name) > _MOST_NAME:
            raise ConfigError(f"{where} leads out of the folder it would be unpacked to, or is no file's name")
        if member.compress_type not in _KINDS or member.flag_bits & _ENCRYPTED:
            raise ConfigError(f"{where} is encrypted or packed by another method than FMI's (deflate)")

    @contextmanager
    def _as_config_error(self, name: str = "") -> Iterator[None]:
        try:
            yield
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError) as error:
            what = f"{name} cannot be read ({error!s:.200})" if name else f"not an FMU ({error!s:.200})"
            raise ConfigError(f"{self._path}: {what}; an FMU is a zip file, BOPTEST's is wrapped.fmu") from error


def _list_bytes(content: bytes) -> int:
    """Return the length of a zip file's list of members as its end states it, bytes; of several ends the largest."""
    sizes = [0]
    for match in re.finditer(rb"PK\x05\x06", content[-(22 + 65_535) :]):
        end = max(0, len(content) - 22 - 65_535) + match.start()
        far = end - 20 - 56
        if far >= 0 and content[end - 20 :].startswith(b"PK\x06\x07") and content[far:].startswith(b"PK\x06\x06"):
            sizes.append(int.from_bytes(content[far + 40 : far + 48], "little"))
        else:
            sizes.append(int.from_bytes(content[end + 12 : end + 16], "little"))
    return max(sizes)
