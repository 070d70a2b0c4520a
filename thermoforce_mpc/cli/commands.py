"""The commands of `tf-mpc` in groups, and the click group that shows them; a command is imported when it is called."""

from __future__ import annotations

import copy
import glob
import importlib
import importlib.util
import itertools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from thermoforce_mpc.cli.completion import completing
from thermoforce_mpc.errors import InputError, suggestion
from thermoforce_mpc.files import odd_number

NAMED_BY = "thermoforce_mpc.options"
"""Key of a click context's `meta`: options by the keys that they give, as in {"period": "--start"}."""
_ROOT = Path(__file__).resolve().parents[2]
# name: (module below `thermoforce_mpc.cli`, or of the benchmarks, and function in it; summary of one line)
GROUPS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "First": {
        "run": ("running.run:run", "Run a controller over a scored window and report KPIs."),
        "compare": ("running.comparing:compare", "Compare controllers on several windows and tariffs."),
        "init": ("inside.files:init", "Write a scenario, test case or map to start from."),
        "explain": ("inside.explain:explain", "Tell what a run decided at an instant, and why."),
        "doctor": ("inside.doctor:doctor", "Check whether everything is there that a run needs."),
    },
    "Run and compare": {
        "resume": ("running.run:resume", "Go on with a run that was ended before its time."),
        "report": ("running.run:report", "Make the report of a run again, also of one cut off."),
        "sweep": ("running.comparing:sweep", "Vary one option; plot cost against discomfort."),
        "fleet": ("running.fleet:fleet", "Run many buildings, windows, tariffs and controllers."),
        "validate": ("inside.files:validate_file", "Check a YAML file without running it."),
    },
    "Your building": {
        "data": ("building.data:data", "Check measurements; plan a probing by hand."),
        "identify": ("building.identify:identify", "Identify a model from probing or measurements."),
        "plan": ("building.plan:plan", "Plan the next hours from measurements in files."),
        "forecast": ("building.forecast:forecast", "Forecast the temperature, with its band."),
        "counterfactual": ("building.forecast:other_levels", "Show what another schedule would have done."),
        "worth": ("building.worth:worth", "What plans would have saved in past days, with a band."),
        "saving": ("building.worth:saving", "What a changed operation saved, with an interval."),
    },
    "Live": {
        "commission": ("live.commission:commission", "Take a building into service, step by step."),
        "control": ("live.control:control", "Control a real building through a connection."),
        "ask": ("live.ask:ask", "Ask a controller for warmer, cooler, away or boost."),
        "record": ("live.record:record", "Write a building's history, or record it."),
        "watch": ("live.watch:watch", "Watch a running controller, here or as a page."),
    },
    "Look inside": {
        "inspect": ("building.identify:inspect", "Show a model, or a run's: parameters, certificate."),
        "testcases": ("inside.listing:testcases", "List test cases, scenarios, comparisons and fleets."),
        "controllers": ("inside.listing:controllers", "List controllers and their options."),
        "plants": ("inside.listing:plants", "List plants and their options."),
        "connections": ("inside.listing:connections", "List connections to real buildings."),
        "free-responses": ("inside.listing:free_responses", "List forecasters of the free response."),
        "schema": ("inside.files:schema", "Write the JSON Schema of a YAML file, for editors."),
    },
    "Services": {
        "serve": ("live.serve:serve", "Serve the embedded plant over BOPTEST's REST protocol."),
        "weather": ("inside.doctor:weather", "Download the weather file of the test case."),
    },
    "Research": {
        "bench": ("benchmarks.cli.bench:command", "Run benchmarks; compare the results with targets."),
        "paper": ("benchmarks.cli.paper:command", "Measure the paper's tables here, beside its figures."),
        "chaos": ("benchmarks.cli.chaos:command", "Run controllers with everything around them failing."),
        "cite": ("inside.doctor:cite", "Print how to cite this software and the paper."),
    },
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}

# What people type for a command that has another name.
SYNONYMS = {
    "simulate": "run", "start": "run", "probe": "identify", "fit": "identify", "learn": "identify", "check": "doctor",
    "predict": "forecast", "list": "testcases", "benchmark": "bench", "show": "inspect", "why": "explain",
    "new": "init", "continue": "resume", "live": "control",
}  # fmt: skip

EXIT_CODES = """\
0    done
1    a check failed (doctor, chaos, commission), there is no plan (plan), or your own controller raised (run)
2    bad input
3    the plant or its service failed, or one of many runs (compare, sweep, fleet)
4    the model is not competent (identify, plan)
5    the service no longer has the test (resume)
6    a file cannot be written: disk full, folder read-only or removed; out of memory
7    the Dask cluster of --scheduler is gone or does not fit
129  the terminal was closed (control, commission)
130  interrupted by Ctrl-C
143  ended by SIGTERM
"""
COMPLETION = """\
Completion of commands, options, names, run folders and files, for this shell session:

  bash:  eval "$(_TF_MPC_COMPLETE=bash_source tf-mpc)"
  zsh:   eval "$(_TF_MPC_COMPLETE=zsh_source tf-mpc)"
  fish:  _TF_MPC_COMPLETE=fish_source tf-mpc | source

For every session, put the line into ~/.bashrc, ~/.zshrc or ~/.config/fish/config.fish.
"""
_TOPICS = {"exit-codes": EXIT_CODES, "completion": COMPLETION}


def _plainly(kind: click.ParamType) -> click.ParamType:
    """`kind`; where it is of numbers, without the texts that only Python takes for one: 1_0 for ten."""
    if not isinstance(kind, click.types.IntParamType | click.types.FloatParamType):
        return kind
    kind, convert = copy.copy(kind), kind.convert

    def plain(value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, str) and odd_number(value):
            kind.fail(f"{value!r} is not a number", param, ctx)
        return convert(value, param, ctx)

    kind.convert = plain  # type: ignore[method-assign]
    return kind


def _completed(command: str, option: click.Parameter, kind: click.ParamType) -> click.ParamType:
    """`kind`, whose values TAB completes, see `completing`."""
    complete = completing(command, option)
    if complete is not None:
        kind = copy.copy(kind)
        kind.shell_complete = complete  # type: ignore[method-assign, assignment]
    return kind


# Options that name a file to write.
_WRITTEN = ("--out", "--plot", "--json", "--commands")


def _files(value: object) -> list[Path]:
    """The files that the value of an option names: a path, several, or a pattern."""
    if isinstance(value, tuple | list):
        return [path for item in value for path in _files(item)]
    if not isinstance(value, str | Path):
        return []
    try:
        there = [Path(value)] if Path(value).exists() else [Path(name) for name in glob.glob(str(value))]
        return [path for path in there if path.is_file()]
    except (OSError, ValueError):  # no name of a file at all
        return []


def _repeated(error: click.UsageError) -> str:
    """What to write where files stand behind an option that takes one at a time: its name before each of them."""
    extra = re.match(r"Got unexpected extra arguments? \((.+)\)$", error.message)
    if extra is None or error.ctx is None:
        return ""
    files = [name for name in (extra[1], extra[1].split()[0]) if _files(name)]
    for option in error.ctx.command.params:
        given = error.ctx.params.get(option.name or "", ())
        if files and option.multiple and _files(given):
            name = option.opts[-1]
            return f"; {name} stands before each file: {name} {given[-1]} {name} {files[0]}"
    return ""


class _KeepingInputs(click.Context):
    """The context of a command, which is not run where a file that it would write is one that it reads."""

    def invoke(self, callback: Any, /, *args: Any, **kwargs: Any) -> Any:
        """Run the command; raises `InputError` naming the option."""
        given = [(option, _files(self.params.get(option.name or ""))) for option in self.command.params]
        written = [(option, path) for option, paths in given if option.opts[-1] in _WRITTEN for path in paths]
        read = [(option, path) for option, paths in given if option.opts[-1] not in _WRITTEN for path in paths]
        for (output, out), (option, path) in itertools.product(written, read):
            if out.samefile(path):
                name = option.opts[-1] if isinstance(option, click.Option) else "the command"
                raise InputError(f"{output.opts[-1]} {out}: {name} reads this file; give another name")
        return super().invoke(callback, *args, **kwargs)


def _leaves(command: click.Command) -> Iterator[click.Command]:
    """A command, or those of a group."""
    if isinstance(command, click.Group):
        for one in command.commands.values():
            yield from _leaves(one)
    else:
        yield command


class CommandGroups(click.Group):
    """Click group that shows its commands in groups and imports only the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands."""
        return [*COMMANDS, "help"]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command, imported; nothing for a name that there is not."""
        if cmd_name == "help":
            return _help
        if cmd_name not in COMMANDS:
            return None
        module, _, function = COMMANDS[cmd_name][0].partition(":")
        command: click.Command
        if module.startswith("benchmarks."):
            command = _benchmark_command(module)
        else:
            command = getattr(importlib.import_module(f"thermoforce_mpc.cli.{module}"), function)
        for option in command.params:
            option.type = _completed(cmd_name, option, _plainly(option.type))
        for leaf in _leaves(command):
            leaf.context_class = _KeepingInputs
        command.name = cmd_name  # functions have other names; the command line reference shows this one
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that was called; an unknown one is refused with the one that may have been meant."""
        known = self.list_commands(ctx)
        if args and not args[0].startswith("-") and args[0] not in known:
            synonym = SYNONYMS.get(args[0].lower())
            meant = f", did you mean '{synonym}'?" if synonym else suggestion(args[0].lower(), known)
            raise click.UsageError(f"No such command '{args[0]:.80}'{meant}", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; an error of a key that an option gave names that option (`NAMED_BY`)."""
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            if hint := _repeated(error):
                raise click.UsageError(error.message + hint, error.ctx) from None
            raise
        except InputError as error:
            words = str(error)
            for key, option in ctx.meta.get(NAMED_BY, {}).items():
                words = re.sub(rf"(?m)^(\s*){re.escape(key)}: ", rf"\g<1>{option}: ", words)
            error.args = (words, *error.args[1:])
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """One section a group, all summaries in one column."""
        width = max(map(len, COMMANDS))
        for title, group in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), summary) for name, (_, summary) in group.items()])


@click.command(name="help", context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("words", nargs=-1)
@click.pass_context
def _help(context: click.Context, words: tuple[str, ...]) -> None:
    """Show the help of a command, of the topics exit-codes and completion, or of tf-mpc."""
    if words and words[0] in _TOPICS:
        click.echo(_TOPICS[words[0]], nl=False)
        return
    at = context.find_root()
    for word in words:
        group = at.command
        if not isinstance(group, click.Group):
            raise click.UsageError(f"{at.command_path} has no commands of its own", at)
        name, command, _ = group.resolve_command(at, [word])
        if command is None:
            raise click.UsageError(f"No such command '{word:.80}'", at)
        at = click.Context(command, info_name=name, parent=at)
    click.echo(at.get_help())


def _benchmark_command(module: str) -> click.Command:
    """`command` of a module of the benchmarks, which are in no wheel; where it is not, one that says how to get it.

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
