"""What the add-on starts: `tf-mpc control` as its options say, with its page behind Home Assistant's ingress.

It begins as root, since /data is root's, and goes on as the image's user.
"""

from __future__ import annotations

import json
import os
import pwd
from collections.abc import Mapping
from pathlib import Path
from typing import Any

CONFIG, DATA = Path("/config"), Path("/data")
"""Where the files of people are (in Home Assistant /addon_configs/…_thermoforce_mpc), and what is kept."""
_USER = "runner"


def command(options: Mapping[str, Any]) -> list[str]:
    """The command of the add-on's options."""
    words = ["tf-mpc", "control", "--mode", options["mode"], "--map", str(CONFIG / options["map"])]
    words += ["--connection", str(CONFIG / options["connection"]), "--out", str(DATA / "control"), "--page", "ingress"]
    if options["mode"] != "probe" and options.get("model"):
        words += ["--model", str(CONFIG / options["model"])]
    return words + [word for setting in options.get("settings", ()) for word in ("--set", setting)]


def environment(options: Mapping[str, Any], given: Mapping[str, str]) -> dict[str, str]:
    """The environment of the command: the add-on's own token for Home Assistant, and the secrets of the options."""
    secrets = {one["name"]: one["value"] for one in options.get("secrets", ())}
    token = {"HOME_ASSISTANT_TOKEN": given["SUPERVISOR_TOKEN"]} if "SUPERVISOR_TOKEN" in given else {}
    return {**given, **token, **secrets}


def main() -> None:
    """Become the command."""
    options = json.loads((DATA / "options.json").read_text(encoding="utf-8"))
    user = pwd.getpwnam(_USER)
    for folder, _, names in os.walk(DATA):
        for path in (folder, *(os.path.join(folder, name) for name in names)):
            if not path.endswith("options.json"):
                os.lchown(path, user.pw_uid, user.pw_gid)
    os.initgroups(_USER, user.pw_gid)
    os.setgid(user.pw_gid)
    os.setuid(user.pw_uid)
    os.chdir(DATA)
    words = command(options)
    os.execvpe(words[0], words, environment(options, {**os.environ, "HOME": user.pw_dir}))


if __name__ == "__main__":
    main()
