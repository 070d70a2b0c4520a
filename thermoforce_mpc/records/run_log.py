"""Log of a run in its folder, `log.jsonl`: one JSON object a line, of messages and of every step with its reason.

Warnings are shown to people too.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

from boptest_client import safe_text
from thermoforce_mpc.data import Plan
from thermoforce_mpc.files import storage_errors
from thermoforce_mpc.loop.closed_loop import StepRecord
from thermoforce_mpc.records.plain_files import open_plain

NAME = "log.jsonl"
_LOGGERS = ("thermoforce_mpc", "controllers", "boptest_client")
# A message of ours may name many keys; what it quotes is cut where it enters.
_MOST_SAID = 20_000
_STEPS = logging.getLogger("thermoforce_mpc.step")


class _JsonLines(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        """The record as one line of JSON; `fields` are those of a step."""
        content = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            **({} if record.name == _STEPS.name else {"from": record.name}),
            **getattr(record, "fields", {}),
            "message": record.getMessage(),
        }
        if record.exc_info:
            content["exception"] = self.formatException(record.exc_info)
        return json.dumps(content, ensure_ascii=False, separators=(",", ":"))


class _Announcer(logging.Handler):
    """Says warnings, as they come."""

    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        """Say one."""
        self._say(safe_text(f"{record.levelname.lower()}: {record.getMessage()}", _MOST_SAID))


class _Lines(logging.StreamHandler[TextIO]):
    def handleError(self, record: logging.LogRecord) -> None:
        """Say nothing: where the disk is full the journal ends the run, and says so."""

    def close(self) -> None:
        """Close the file; lines that a full disk did not take are lost."""
        super().close()
        with suppress(OSError):
            self.stream.close()


@contextmanager
def logging_to(folder: Path, say: Callable[[str], None] = lambda text: None) -> Iterator[None]:
    """Append what the package logs to `log.jsonl` in `folder`, and `say` warnings; raises `StorageError`."""
    with storage_errors(folder / NAME):
        file = open_plain(folder / NAME, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        file_handler = _Lines(os.fdopen(file, "a", encoding="utf-8", errors="backslashreplace"))
    file_handler.setFormatter(_JsonLines())
    handlers = (file_handler, _Announcer(say))
    levels_before = {name: logging.getLogger(name).level for name in _LOGGERS}
    for name in _LOGGERS:
        for handler in handlers:
            logging.getLogger(name).addHandler(handler)
        logging.getLogger(name).setLevel(logging.INFO)
    try:
        yield
    finally:
        for name, level in levels_before.items():
            for handler in handlers:
                logging.getLogger(name).removeHandler(handler)
            logging.getLogger(name).setLevel(level)
        file_handler.close()


def log_step(controller: str, step: StepRecord) -> None:
    """Log one step: what acted, and why."""
    levels = [sample.u_applied for sample in step.samples]
    log_decision(controller, step.index, step.time_s, step.plan, levels, step.refused, step.notes)


def log_decision(
    controller: str,
    index: int,
    time_s: float,
    plan: Plan,
    levels: Sequence[Sequence[float | None]],
    refused: str,
    notes: Sequence[str],
) -> None:
    """Log what was decided at `time_s`: the levels of each block, and why."""
    fields = {
        "controller": controller,
        "step": index,
        "time_s": time_s,
        "status": plan.status.value,
        "u": [list(block) for block in levels],
    } | {key: value for key, value in (("refused", refused), ("notes", list(notes))) if value}
    _STEPS.info("%s", plan.why, extra={"fields": fields})
