"""Commands of the package `benchmarks`, which stands beside this one in a checkout and is in no wheel."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path

import click

from thermoforce_mpc.errors import InputError

_ROOT = Path(__file__).resolve().parents[2]


def benchmark_command(module: str) -> click.Command:
    """`command` of a module of the benchmarks; where they are not there, one that says how to get them.

    `benchmarks` is a common name: it is taken from the root of a checkout alone.
    """
    missing = "is not part of the wheel: clone the repository and run `pip install -e '.[bench]'` in it"
    if (_ROOT / "pyproject.toml").is_file():
        ours = _ROOT / "benchmarks" / "__init__.py"
        spec = importlib.util.find_spec("benchmarks")
        if spec is not None and spec.origin is not None:
            if Path(spec.origin).resolve() == ours:
                command: click.Command = importlib.import_module(module).command
                return command
            missing = f"is in {ours.parent}, which {spec.origin} hides: take that off the Python path"

    @click.command(context_settings={"ignore_unknown_options": True}, add_help_option=False)
    @click.argument("words", nargs=-1, type=click.UNPROCESSED)
    @click.pass_context
    def absent(context: click.Context, words: tuple[str, ...]) -> None:
        raise InputError(f"tf-mpc {context.info_name} {missing}")

    return absent
