"""Files that a run reads (weather, prices, an FMU, a saved model, a test case), sent to where they are not."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, WithJsonSchema

from controllers.registry import find_entry
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution import Task
from thermoforce_mpc.execution.keys import digest
from thermoforce_mpc.experiment.identifying import IdentificationTask
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.model.free_response.registry import may_be_file
from thermoforce_mpc.scenario.scenario import Scenario

Change = Callable[[str], str]
_Inputs = TypeVar("_Inputs", Scenario, IdentificationTask)


@dataclass(frozen=True)
class InputFiles:
    """Paths of files and folders, as the user gave them, and the hash of each file in them by its place below."""

    hashes: Mapping[str, Mapping[str, str]]

    def read(self) -> SentFiles:
        """Their content; raises `ConfigError`."""
        try:
            return SentFiles(self, {p: {n: _file_at(p, n).read_bytes() for n in of} for p, of in self.hashes.items()})
        except OSError as error:
            raise ConfigError(f"{error.filename}: cannot be read ({error.strerror or error})") from error


@dataclass(frozen=True)
class SentFiles:
    """Content of files, by path and place."""

    files: InputFiles
    content: Mapping[str, Mapping[str, bytes]]

    @contextmanager
    def at_hand(self) -> Iterator[Mapping[str, str]]:
        """Where each path is here: itself, if the same files are there, else a copy for as long as this lasts."""
        with tempfile.TemporaryDirectory() as folder:
            where = {}
            for n, (path, hashes) in enumerate(self.files.hashes.items()):
                if _has_content(path, hashes):
                    where[path] = path
                    continue
                copy = Path(folder) / str(n) / Path(path).name
                for name, content in self.content[path].items():
                    target = copy / name if name else copy
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(content)
                where[path] = str(copy)
            yield where


NO_FILES = SentFiles(InputFiles({}), {})


def input_files(paths: Iterable[str]) -> InputFiles | None:
    """What is to be sent of `paths`; None for no paths. Raises `ConfigError` if one cannot be read."""
    hashes = {path: file_hashes(path) for path in sorted(set(paths))}
    return InputFiles(hashes) if hashes else None


def file_hashes(path: str) -> dict[str, str]:
    """The hash of each file in a folder by its place below, or of a file by ''; raises `ConfigError`."""
    place = Path(path).expanduser()
    try:
        if place.is_dir():
            below = sorted(file for file in place.rglob("*") if file.is_file())
            return {file.relative_to(place).as_posix(): file_sha256(file) for file in below}
        return {"": file_sha256(place)}
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error


def task_of(files: InputFiles) -> Task:
    """The task whose value is the content of `files`, for tasks that need it."""
    return Task(digest({"files": files.hashes}), ", ".join(files.hashes), InputFiles.read, files)


def paths_of(inputs: _Inputs) -> list[str]:
    """Paths that a run or an identification reads."""
    found: list[str] = []

    def note(path: str) -> str:
        found.append(path)
        return path

    def note_option(text: str) -> str:
        return note(text) if _is_there(text) else text

    _with_paths(inputs, note, note_option)
    return found


def named_files(controller: str, options: Mapping[str, Any]) -> list[str]:
    """Files and folders named in options of a controller, such as a forecaster's checkpoint."""
    texts: list[str] = []

    def note(text: str) -> str:
        texts.append(text)
        return text

    with_files(controller, options, note)
    return [text for text in texts if _is_there(text)]


def moved(inputs: _Inputs, where: Mapping[str, str]) -> _Inputs:
    """What a run or an identification is made from, with the files of `where`."""

    def move(path: str) -> str:
        return where.get(path, path)

    return _with_paths(inputs, move, move)


def _with_paths(inputs: _Inputs, change: Change, in_options: Change) -> _Inputs:
    """`inputs` with `change` applied to each path, and `in_options` to each text of options that may be one."""
    spec = inputs.plant
    plant = spec.model_copy(update={field: change(path) for field, path in spec.files().items()})
    if isinstance(inputs, IdentificationTask):
        return replace(inputs, plant=plant, probed=change(inputs.probed_files) if inputs.probed_files else None)
    testcase, controller, identification = inputs.testcase, inputs.controller, inputs.identification
    update = {
        "testcase": change(testcase) if Path(testcase).suffix in (".yaml", ".yml") else testcase,
        "plant": plant,
        "controller": controller.model_copy(
            update={"options": with_files(controller.name, controller.options, in_options)}
        ),
    }
    if identification.model:
        update["identification"] = identification.model_copy(update={"model": change(identification.model)})
    return inputs.model_copy(update=update)


def _is_there(text: str) -> bool:
    return bool(text) and Path(text).expanduser().exists()


def _file_at(path: str, name: str) -> Path:
    place = Path(path).expanduser()
    return place / name if name else place


def _has_content(path: str, hashes: Mapping[str, str]) -> bool:
    try:
        return all(file_sha256(_file_at(path, name)) == expected for name, expected in hashes.items())
    except OSError:
        return False


def with_files(controller: str, options: Mapping[str, Any], change: Change) -> dict[str, Any]:
    """Options of a controller with `change` applied to each text that may name a file or folder.

    That is free text, but no name of a registry, choice or default. Raises `ConfigError` for an unknown controller.
    """
    return _change_model(find_entry(controller).config(), options, change)


def _change_model(model: type[BaseModel], values: Mapping[str, Any], change: Change) -> dict[str, Any]:
    changed = dict(values)
    for key, value in values.items():
        field = model.model_fields.get(key)
        # `one_of` marks a name of a registry.
        if field is None or value == field.default or any(isinstance(mark, WithJsonSchema) for mark in field.metadata):
            continue
        if key == "options" and _is_free_response(model):
            name = values.get("name") or model.model_fields["name"].default
            changed[key] = {option: change(v) if may_be_file(name, option, v) else v for option, v in value.items()}
        else:
            changed[key] = _change_value(field.annotation, value, change)
    return changed


def _is_free_response(model: type[BaseModel]) -> bool:
    from controllers.mpc.config import FreeResponseConfig  # with what plans need

    return issubclass(model, FreeResponseConfig)


def _change_value(kind: Any, value: Any, change: Change) -> Any:
    """`value` of a field annotated as `kind`; a `Literal` or enum is no text."""
    inner = get_args(kind)
    if get_origin(kind) is Annotated:
        return _change_value(inner[0], value, change)
    if get_origin(kind) in (Union, UnionType):
        for member in inner:
            value = _change_value(member, value, change)
        return value
    if kind in (str, Path, Any) and isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return _change_model(kind, value, change)
        of = inner[1] if len(inner) == 2 else Any if kind in (Any, dict) else None
        return {key: _change_value(of, item, change) for key, item in value.items()} if of else value
    if isinstance(value, list | tuple):
        of = inner[0] if inner else Any if kind in (Any, list, tuple) else None
        return [_change_value(of, item, change) for item in value] if of else value
    return value
