"""What the documentation tells people to type is known to the program, and its code is code."""

from __future__ import annotations

import importlib.util
import re
import shlex
from collections.abc import Iterator

import click
import pytest
import yaml
from pages import PAGES, blocks
from places import ROOT

from thermoforce_mpc.cli import cli

_COMMAND = re.compile(r"(?:^|[\s/(`])tf-mpc((?: [^\n`;|)]+)?)")
_MODULE = re.compile(r"python3? -m ([\w.]+)")


def typed(page) -> list[str]:
    """Every `tf-mpc` command line of a page: of its blocks of commands, and of its code marks."""
    told = [b.text for b in blocks(page) if b.language == "bash"]
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    told += [code.replace("\n", " ") for code in re.findall(r"`([^`]*tf-mpc[^`]*)`", text)]
    lines = [re.sub(r"\\\n\s*", " ", one) for one in told]
    return [found.strip() for one in lines for found in _COMMAND.findall(re.sub(r"\s#.*", "", one))]


def unknown(line: str) -> str:
    """What of a command line the program does not know, or nothing."""
    words = [word for word in shlex.split(line.replace("…", "")) if word != "&&"]
    command: click.Command = cli
    context = click.Context(cli)
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        name = words.pop(0)
        below = command.get_command(context, name)
        if below is None:
            return "" if name.isupper() else f"command {name}"
        command = below
    known = {option for one in command.get_params(context) for option in (*one.opts, *one.secondary_opts)}
    options = [word.split("=")[0] for word in words if re.fullmatch(r"--?[a-z][\w-]*(=.*)?", word)]
    return ", ".join(option for option in options if option not in known | {"-h", "--help"})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_options_and_modules_are_known(page):
    wrong = {line: unknown(line) for line in typed(page)}
    assert {line: what for line, what in wrong.items() if what} == {}
    for module in _MODULE.findall(page.read_text(encoding="utf-8")):
        assert module in ("venv", "pytest") or importlib.util.find_spec(module), module


def commands(command: click.Command = cli) -> Iterator[click.Command]:
    """A command and all below it."""
    yield command
    if isinstance(command, click.Group):
        for name in command.list_commands(click.Context(command)):
            yield from commands(command.get_command(click.Context(command), name))


def refused(words: list[str]) -> str:
    """Why the program does not take a call, or nothing; files that are not there are the caller's."""
    command, name = cli, "tf-mpc"
    try:
        while isinstance(command, click.Group) and words and not words[0].startswith("-"):
            name, command, words = command.resolve_command(click.Context(command, info_name=name), words)
        command.make_context(name, list(words))
    except click.exceptions.Exit:  # --help
        return ""
    except click.UsageError as error:
        return "" if error.message.endswith("does not exist.") else error.message
    return ""


def test_examples_of_the_help_are_calls_that_the_program_takes():
    told = [block for one in commands() for block in re.findall(r"Examples?:\n((?:\s*tf-mpc .*\n?)+)", one.help or "")]
    said = [line.strip() for block in told for line in block.splitlines() if line.strip()]
    assert len(said) > 60
    wrong = {line: refused(shlex.split(line)[1:]) for line in said}
    assert {line: what for line, what in wrong.items() if what} == {}
    assert "not in the range" in refused(["bench", "mqtt", "--days", "99"])
    assert "No such option" in refused(["run", "--nonsense"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_python_compiles_and_yaml_parses(page):
    for block in blocks(page):
        if block.language == "python":
            compile(block.text, str(page), "exec")
        elif block.language == "yaml":
            yaml.safe_load(block.text)


def test_a_command_that_does_not_exist_is_found():
    assert unknown("run --testcase x --nonsense 3") == "--nonsense"
    assert unknown("data chekc x.csv") == "command chekc"
    assert unknown("data check x.csv --no-fit") == ""
    assert len([line for page in PAGES for line in typed(page)]) > 100
