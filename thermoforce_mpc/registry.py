"""Things found by name: those of this package, and those that other distributions announce by entry point.

A distribution announces, say, a controller in its pyproject.toml; it is imported when somebody names it:

    [project.entry-points."thermoforce_mpc.controllers"]
    my_rule = "my_package:MY_RULE"

See docs/how-to/plugins.md for what each group expects.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from importlib.metadata import Distribution, EntryPoint, distributions, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, TypeVar

from thermoforce_mpc.errors import HiddenPackage, InputError, suggestion

T = TypeVar("T")
PREFIX = "thermoforce_mpc"
OWN = "thermoforce-mpc"


def names_in(text: str | None) -> tuple[str, ...]:
    """The names of a list that people separate by commas, without spaces around them; none of None."""
    return tuple(name for part in (text or "").split(",") if (name := part.strip()))


@dataclass(frozen=True)
class Listed(Generic[T]):
    """A name, the distribution that it comes from, and what it stands for, or why that cannot be used."""

    name: str
    origin: str
    found: T | None
    problem: str = ""


class Registry(Generic[T]):
    """Things of one kind by name.

    Those of this package are `own`; plugins announce theirs in `thermoforce_mpc.<group>`. One that cannot be imported,
    is `wrong` (says why, or nothing) or has a name of ours fails alone, with `error`, when it is named; `made` makes
    what is registered from its name and the object that it gives.
    """

    def __init__(
        self,
        kind: str,
        group: str,
        own: Mapping[str, T],
        error: type[InputError],
        wrong: Callable[[object], str],
        made: Callable[[str, Any], T] = lambda name, found: found,
    ) -> None:
        self.kind, self.group, self.own = kind, f"{PREFIX}.{group}", dict(own)
        self._error, self.wrong, self.made = error, wrong, made
        self._loaded: dict[str, T] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """All names, ours first; nothing is imported."""
        return (*self.own, *(name for name in self._announced if name not in self.own))

    def __contains__(self, name: object) -> bool:
        return name in self.own or name in self._announced

    def find(self, name: str) -> T:
        """What `name` stands for; raises `error` where nobody or two have the name, or the plugin cannot be used."""
        if name in self.own:
            return self.own[name]
        if name not in self._announced:
            raise self._error(_unknown(self.kind, name, self.names))
        if name not in self._loaded:
            plugins = self._announced[name]
            if len(plugins) > 1:
                both = " and ".join(_told(plugin) for plugin in plugins)
                raise self._error(f"{self.kind} '{name}' is announced by {both}: uninstall one of them")
            self._loaded[name] = self._load(plugins[0])
        return self._loaded[name]

    def listing(self) -> tuple[Listed[T], ...]:
        """All names with what they stand for; imports the plugins, and raises nothing for one that fails."""
        out = [Listed(name, OWN, found) for name, found in self.own.items()]
        for name, plugins in self._announced.items():
            origin = " and ".join(_told(plugin) for plugin in plugins)
            try:
                if name in self.own:
                    raise InputError(f"not used: '{name}' is a {self.kind} of {OWN}; rename the plugin's")
                out.append(Listed(name, origin, self.find(name)))
            except InputError as problem:
                out.append(Listed(name, origin, None, str(problem)))
        return tuple(out)

    @cached_property
    def _announced(self) -> dict[str, list[EntryPoint]]:
        return announced(self.group)

    def _load(self, plugin: EntryPoint) -> T:
        where = f"{self.kind} '{plugin.name}' of {_told(plugin)}"
        try:
            found = plugin.load()
        except (Exception, SystemExit) as problem:  # whatever somebody's module does while it is imported
            raise self._error(
                f"{where} cannot be imported ({type(problem).__name__}: {' '.join(str(problem).split())[:300]}); "
                "mend or uninstall it"
            ) from problem
        wrong = self.wrong(found)
        if wrong:
            raise self._error(f"{where} cannot be used: {wrong}")
        return self.made(plugin.name, found)


def lazy_names(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """`__getattr__` of a package whose public names are imported from their modules, `homes`, on first use."""

    def attribute(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'; it has {', '.join(homes)}")
        try:
            home = import_module(homes[name])
        except ImportError:
            check_nothing_hides_us()
            raise
        return getattr(home, name)

    return attribute


def check_nothing_hides_us() -> None:
    """Raise `HiddenPackage` where a folder or file called `controllers` is imported in the place of ours.

    Python looks into the folder of a script, with `python -m` into the working directory, before installed packages.
    """
    ours = Path(__file__).resolve().parents[1] / "controllers"
    spec = find_spec("controllers")
    if spec is None:
        return
    places = [Path(place) for place in spec.submodule_search_locations or ([spec.origin] if spec.origin else [])]
    if places and not any(place.resolve() == ours for place in places):
        raise HiddenPackage(
            f"{places[0]} hides the package `controllers` that thermoforce-mpc needs ({ours}): rename yours, or start "
            "Python in another folder"
        )


def announced(group: str) -> dict[str, list[EntryPoint]]:
    """Entry points of a group by name, in the order of names and distributions; nothing is imported."""
    found: dict[str, list[EntryPoint]] = {}
    for plugin in sorted(set(entry_points(group=group)), key=lambda one: (one.name, _told(one))):
        found.setdefault(plugin.name, []).append(plugin)
    return found


def plugins() -> dict[str, str]:
    """Versions of the installed distributions that announce anything in a group of ours, by name."""
    return {name: one.version for name, one in _announcing().items()}


def plugin_sources() -> dict[str, str]:
    """Version and hash of what `plugins` lists; nothing is imported; raises `OSError` for a file that cannot be read.

    Hashed are the files of each announced module's top-level package.
    """
    return {
        name: f"{one.version} {_content(sorted({plugin.module.partition('.')[0] for plugin in _ours(one)}))}"
        for name, one in _announcing().items()
    }


def _announcing() -> dict[str, Distribution]:
    found: dict[str, Distribution] = {}
    for one in distributions():
        # In this order: a name is in a distribution's metadata, and reading those of all takes a tenth of a second.
        if _ours(one) and one.name != OWN:
            found.setdefault(one.name, one)  # the first on the path is the one that is imported
    return found


def _ours(one: Distribution) -> list[EntryPoint]:
    return [plugin for plugin in one.entry_points if plugin.group.startswith(f"{PREFIX}.")]


def _content(modules: Collection[str]) -> str:
    """Hash of modules' files, 16 hexadecimal digits; a module that is not there has none."""
    total = hashlib.sha256()
    for module in modules:
        total.update(module.encode())
        spec = find_spec(module)
        if spec is None:
            continue
        if spec.submodule_search_locations is None:
            files = [Path(spec.origin)] if spec.has_location and spec.origin else []
        else:
            folders = [Path(folder) for folder in spec.submodule_search_locations]
            files = [file for folder in folders for file in sorted(folder.rglob("*")) if file.is_file()]
        for file in files:
            if "__pycache__" not in file.parts:
                total.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()[:16]


def known_name(kind: str, group: str, *own: str) -> Callable[[str], str]:
    """A check for pydantic that a name is one of `own` or announced in `thermoforce_mpc.<group>`; imports nothing."""

    def checked(name: str) -> str:
        if name not in own and name not in (others := announced(f"{PREFIX}.{group}")):
            raise ValueError(_unknown(kind, name, (*own, *others)))
        return name

    return checked


def builder(found: object) -> str:
    """The check that a plugin gives something that can be called."""
    return "" if callable(found) else f"it is a {type(found).__name__}, not a function or class"


def _unknown(kind: str, name: str, known: Collection[str]) -> str:
    return f"unknown {kind} '{name}'{suggestion(name, known)}; known: {', '.join(known)}"


def _told(plugin: EntryPoint) -> str:
    source = f"{plugin.dist.name} {plugin.dist.version}" if plugin.dist else "an unknown distribution"
    return f"{source} ({plugin.value})"
