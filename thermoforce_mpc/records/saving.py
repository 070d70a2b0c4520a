"""What a run at a building saved so far, as its accounts say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import read_bounded

# Accounts in the folder of a run, the first one counts: of what was set (`tf-mpc saving`), of what a shadow would have.
VERIFIED, SHADOW = "saving.json", "shadow.json"
MOST_BYTES = 10_000_000
_NONE = "not known yet: --mode shadow says what would be saved, `tf-mpc saving --out` into this folder what was"


def saving_so_far(folder: Path) -> dict[str, Any]:
    """The account in `folder`: `said` in a sentence, and numbers, where there are some."""
    for name in (VERIFIED, SHADOW):
        try:
            told = json.loads(read_bounded(folder / name, MOST_BYTES, InputError))
            return {key: one for key, one in told.items() if isinstance(one, str | int | float)} | {
                "said": str(told["said"])
            }
        except (OSError, InputError, ValueError, KeyError, AttributeError, TypeError):
            continue
    return {"said": _NONE}
