"""Functions compiled by numba, kept on disk under a hash of all sources that they hold.

numba and LLVM take 97 MB and a third of a second: a process that calls none of these functions does not load them.

numba keeps a function by the file that it stands in. Of functions and constants of other files that it took in when it
was compiled it knows nothing, and goes on with those as they were.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, cached_property, update_wrapper
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

from thermoforce_mpc.files import cache_folder

_LOG = logging.getLogger(__name__)
_ROOT = Path(__file__).parents[2]
_PACKAGES = ("thermoforce_mpc", "controllers")
# Imports of a module itself: what a function compiled takes in stands at its module's own level.
_IMPORTS = re.compile(r"^(?:from[ ]([\w.]+)[ ]import[ ](\([^)]*\)|[^\n]*)|import[ ]([^\n]*))", re.M)
# Packages of others whose functions ours take in: their versions count as sources.
_TAKEN_IN = ("psychrolib",)
# Longest wait for another process that compiles, s: ten times what the slowest takes on a busy machine.
_LONGEST_S = 120.0
# Folders of other sources that no process has used for as long are removed, days.
_KEPT_DAYS = 30.0


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with these options, applied when the function is first called.

    They return numbers, and write arrays into those that they are given: numba makes anything else by calling Python,
    where a signal may raise, and the process crashes over that.

    With `cache=True` it is kept by `sources_of` its file, in `NUMBA_CACHE_DIR` where that is set, else in the user's
    cache folder. What cannot be written there is not kept, and what cannot be read is compiled again.
    """
    return lambda function: _Compiled(function, options)


class _Compiled:
    """A function that is compiled when it is first called, with those of ours that it calls."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self._function, self._options, self._ready = function, options, False
        update_wrapper(self, function)

    def __call__(self, *args: Any) -> Any:
        if not self._ready:
            self._compile(args)
        return self.dispatcher(*args)

    def _compile(self, args: tuple[Any, ...]) -> None:
        """Compile it for these arguments, or read it: of several processes that ask at once, one compiles."""
        import numba

        dispatcher, self._ready = self.dispatcher, True
        with _alone(self._kept_in):
            dispatcher.compile(tuple(map(numba.typeof, args)))

    @cached_property
    def _kept_in(self) -> str | None:
        """The folder in which it is kept; None where it is not."""
        return _folder(str(self._function.__globals__["__file__"])) if self._options.get("cache") else None

    @cached_property
    def dispatcher(self) -> Any:
        """numba's object. It stands in our place in the function's module too, where numba looks for what it calls."""
        import numba

        function, names = self._function, self._function.__globals__
        used = function.__code__.co_names
        for module in [names, *(vars(found) for name in used if isinstance(found := names.get(name), ModuleType))]:
            for name in used:
                if isinstance(called := module.get(name), _Compiled) and called is not self:
                    module[name] = called.dispatcher
        folder = self._kept_in
        given = self._options if folder else {**self._options, "cache": False}
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = folder or before
        try:
            compiled = numba.njit(**given)(function)
        finally:
            numba.config.CACHE_DIR = before
        if folder:
            _without_it(compiled._cache)
        if names.get(function.__name__) is self:
            names[function.__name__] = compiled
        return compiled


def _without_it(kept: Any) -> None:
    """Have numba's store of a function do without what it cannot write (a full disk) or read (cut short by a crash)."""
    save, load = kept.save_overload, kept.load_overload

    def saved(*what: Any) -> None:
        try:
            save(*what)
        except OSError as error:
            _LOG.info("%s: what was compiled is not kept: %s", kept.cache_path, error)

    def loaded(*what: Any) -> Any:
        try:
            return load(*what)
        except Exception as error:  # unpickling raises anything
            _LOG.info("%s: what was compiled cannot be read (%s): compiled again", kept.cache_path, error)
        with suppress(OSError):
            kept.flush()  # numba reads the list of what it kept before it adds to it
        return None

    kept.save_overload, kept.load_overload = saved, loaded


@contextmanager
def _alone(folder: str | None) -> Iterator[None]:
    """Whoever else comes to `folder` waits until the end; nobody where there is none, or it is held for too long."""
    from filelock import FileLock

    with ExitStack() as held:
        if folder is not None:
            with suppress(OSError, NotImplementedError):  # what it is for comes anyway, if later
                held.enter_context(FileLock(Path(folder) / "compiling.lock").acquire(timeout=_LONGEST_S))
        yield


def sources_of(file: Path) -> list[Path]:
    """A module's file and those of all modules of ours that it imports, and so on."""
    found, left = set[Path](), [file.resolve()]
    while left:
        path = left.pop()
        if path in found:
            continue
        found.add(path)
        for module, names, plain in _IMPORTS.findall(path.read_text(encoding="utf-8")):
            if plain:
                imported = [_file(name.split()[0]) for name in plain.split(",")]
            else:
                each = (name.split()[0] for name in names.strip("() \n").split(",") if name.strip())
                imported = [_file(f"{module}.{name}") or _file(module) for name in each]
            left += filter(None, imported)
    return sorted(found)


def _file(module: str) -> Path | None:
    """The file of a module of ours; None where it is of others, or no module."""
    parts = module.split(".")
    if parts[0] not in _PACKAGES:
        return None
    file = _ROOT.joinpath(*parts)
    return next((each for each in (file.with_suffix(".py"), file / "__init__.py") if each.is_file()), None)


@cache
def sources_hash(file: str) -> str:
    """SHA-256 of the text of `sources_of` a module's file, hexadecimal: of what decides about what is kept of it."""
    hashed = hashlib.sha256()
    for source in sources_of(Path(file)):
        text = source.read_bytes()
        hashed.update(source.name.encode() + b"\0" + text + b"\0")
        for package in _TAKEN_IN:
            if f"import {package}".encode() in text:
                hashed.update(f"{package} {version(package)}\0".encode())
    return hashed.hexdigest()


@cache
def _folder(file: str) -> str | None:
    """Where functions of a file are kept; None where nothing can be."""
    import numba

    # numba itself tells processors and Pythons apart.
    name = hashlib.sha256(f"{numba.__version__} {sources_hash(file)}".encode()).hexdigest()[:32]
    try:
        ours = cache_folder() / "compiled"
        folder = Path(numba.config.CACHE_DIR or ours) / name
        new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        if not os.access(folder, os.W_OK):
            raise PermissionError(f"{folder} cannot be written")
        if new and folder.parent == ours:
            _clear(ours)
    except (OSError, RuntimeError) as error:  # RuntimeError: who runs this has no home
        _LOG.info("compiled functions are not kept: %s", error)
        return None
    return str(folder)


def _clear(folder: Path) -> None:
    oldest = time.time() - _KEPT_DAYS * 86400.0
    for each in folder.iterdir():
        if each.stat().st_mtime < oldest:
            shutil.rmtree(each, ignore_errors=True)
