"""Functions and classes of others: in a file, as `path/to/file.py:name`, or a plugin's; their parameters as options."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import sys
import traceback
import warnings
from collections.abc import Callable, Collection, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, create_model

from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import read_bounded
from thermoforce_mpc.scenario.settings import StrictModel

_MOST_BYTES = 5_000_000


def is_own_code(name: str) -> bool:
    """Whether `name` names something in a file of the user's."""
    return ".py:" in name


def is_policy(name: str) -> bool:
    """Whether `name` is that of a trained policy's file."""
    return name.endswith(".zip")


def policy_settings(name: str) -> Path:
    """The file of a policy's settings, beside it."""
    return Path(name).with_suffix(".json")


def code_file(name: str) -> str | None:
    """The file whose code a controller or KPI of this `name` runs; a trained policy is unpickled."""
    if is_own_code(name):
        return name.rpartition(":")[0]
    return name if is_policy(name) else None


def own_code(where: str, key: str, error: Callable[[str], InputError]) -> Any:
    """What `where`, a `path/to/file.py:name` from the working directory, names, as at the file's last change.

    Raises `error`, with the `key` that it was given by, where the file cannot be read or raises, or has no such name.
    """
    file, _, name = where.rpartition(":")
    path = Path(file)
    if path.suffix != ".py" or not name:
        raise error(f"{key}: {where!r}: expected path/to/file.py:name")
    if not path.is_file():
        raise error(f"{key}: {where!r}: no such file in {Path.cwd()}")
    content = _content(path.resolve(), path.stat().st_mtime_ns, key, error)
    if not callable(content.get(name)):
        own = {key: value for key, value in content.items() if callable(value) and not key.startswith("_")}
        public = [key for key, value in own.items() if getattr(value, "__module__", "") == content["__name__"]]
        raise error(f"{key}: {path} has no {name!r}; it has {', '.join(public) or 'nothing that can be called'}")
    return content[name]


class PythonSource(NamedTuple):
    """What a file of Python holds: how many `lines`, what it defines and which modules it would import, both sorted."""

    lines: int
    defines: tuple[str, ...]
    imports: tuple[str, ...]

    def __str__(self) -> str:
        defines, imports = ", ".join(self.defines) or "nothing", ", ".join(self.imports) or "nothing"
        return f"{self.lines} lines of Python, define {defines}, import {imports}"


def looked_at(where: str, key: str, error: type[InputError]) -> PythonSource:
    """What the file of `where`, a `path/to/file.py:name` or the path alone, holds, without running it.

    Raises `error`, with the `key` that it was given by, where it cannot be read, is not Python, or has no such name.
    """
    file, _, name = where.rpartition(":") if is_own_code(where) else (where, "", "")
    if not Path(file).is_file():
        raise error(f"{key}: {where!r}: no such file in {Path.cwd()}")
    source = read_bounded(Path(file), _MOST_BYTES, error)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of invalid escapes
            tree = ast.parse(source, file)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as problem:
        raise error(f"{key}: {file} is not Python: {problem}") from problem
    nodes = list(ast.walk(tree))
    imports = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imports |= {"." * node.level + (node.module or "") for node in nodes if isinstance(node, ast.ImportFrom)}
    made = [node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef)]
    # A name may also be imported or assigned, or come with a star.
    bound = {alias.asname or alias.name for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names}
    bound |= {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    if name and not {name, "*"} & {*made, *bound}:
        raise error(f"{key}: {file} has no {name!r}; it has {', '.join(made) or 'nothing that can be called'}")
    top = [node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef)]
    modules = sorted({module.partition(".")[0] or module for module in imports})
    return PythonSource(len(source.splitlines()), tuple(sorted(top)), tuple(modules))


@cache
def _content(path: Path, changed_ns: int, key: str, error: Callable[[str], InputError]) -> dict[str, Any]:
    spec = importlib.util.spec_from_file_location(f"own_code_{path.stem}", path)
    assert spec is not None  # of a file that exists
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses and pickle look for it
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as problem:  # whatever the file raises
        at = line_in(str(path), problem)
        raise error(f"{key}: {path}{at} raised {type(problem).__name__}: {problem}") from problem
    return vars(module)


def line_in(file: str | None, error: BaseException) -> str:
    """', line N': the last line of `file` that led to an error; '' where none did."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f", line {lines[-1]}" if lines else ""


_PLAIN = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


def unfit(make: object, handed: Collection[str]) -> str:
    """What is wrong with a plugin's function or class, or nothing: parameters that are not `handed` need a default."""
    if not callable(make):
        return f"it is a {type(make).__name__}, not a function or class"
    try:
        parameters = inspect.signature(make).parameters
    except ValueError as error:
        return str(error)
    if odd := [name for name, one in parameters.items() if one.kind not in _PLAIN]:
        return f"its parameters {', '.join(odd)} have no name to set them by"
    bare = [name for name, one in parameters.items() if name not in handed and one.default is inspect.Parameter.empty]
    if bare:
        can = f"; without one: {', '.join(handed)}" if handed else ""
        return f"its parameters {', '.join(bare)} have no default{can}"
    try:
        options_model(make, handed).model_validate({})
    except Exception as error:  # somebody's annotations
        return f"its options cannot be checked: {error}"
    return ""


def options_model(make: Callable[..., Any], handed: Collection[str]) -> type[StrictModel]:
    """The options of a function or class as a model: its parameters but those `handed`, with types and defaults.

    A parameter without an annotation has the type of its default; its meaning is that of the docstring's `Args:`.
    """
    meanings = _meanings(make)
    names = getattr(make.__init__ if inspect.isclass(make) else make, "__globals__", {})
    fields: dict[str, Any] = {}
    for name, one in inspect.signature(make).parameters.items():
        if name not in handed:
            kind = one.annotation
            if kind is inspect.Parameter.empty:
                kind = Any if one.default is None else type(one.default)
            # Only these: what is handed may have a type that is imported for type checking alone.
            kind = eval(kind, names) if isinstance(kind, str) else kind
            fields[name] = (kind, Field(one.default, description=meanings.get(name)))
    return create_model(f"Options of {getattr(make, '__name__', 'a plugin')}", __base__=StrictModel, **fields)


def _meanings(make: Callable[..., Any]) -> dict[str, str]:
    """What the section `Args:` of a docstring says of each parameter."""
    doc = inspect.getdoc(make.__init__ if inspect.isclass(make) else make) or ""
    descriptions: dict[str, str] = {}
    for line in doc.partition("\nArgs:\n")[2].splitlines():
        if not line.startswith("    "):
            break
        name, colon, text = line.strip().partition(": ")
        if colon and line[4] != " ":
            descriptions[name] = text
        elif descriptions:
            descriptions[next(reversed(descriptions))] += f" {line.strip()}"
    return descriptions


def called(make: Callable[..., Any], options: StrictModel, given: Mapping[str, Any]) -> Any:
    """What `make` returns for validated `options`, and of what is `given` the parameters that it has."""
    asked = inspect.signature(make).parameters
    own = {name: getattr(options, name) for name in type(options).model_fields}
    return make(**{name: value for name, value in given.items() if name in asked}, **own)


def first_line(make: object) -> str:
    """First line of the docstring of a function or class."""
    return (getattr(getattr(make, "func", make), "__doc__", None) or "").strip().partition("\n")[0].rstrip(".")
