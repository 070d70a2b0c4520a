"""Put the add-on of Home Assistant together: what is in `addon`, a Dockerfile made of ours, and the sources.

    python -m tools.addon DIR

The Supervisor builds an add-on from its own folder alone: copy DIR to /addons of Home Assistant.
"""

from __future__ import annotations

import shutil
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# What the image's wheel is built of, and by which constraints.
_SOURCES = (
    "thermoforce_mpc", "controllers", "boptest_client", "configs", "pyproject.toml", "README.md", "LICENSE",
    "NOTICE.md", "CITATION.cff", "requirements.txt", "constraints.txt",
)  # fmt: skip


def dockerfile() -> str:
    """Our Dockerfile as far as what it installs; then what the add-on starts, as root, which it leaves."""
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    kept = lines[next(k for k, line in enumerate(lines) if line.startswith("FROM ")) : lines.index("USER runner")]
    text = "\n".join(kept).replace("COPY . /src", "COPY src /src")
    if "COPY src /src" not in text:
        raise SystemExit("Dockerfile: `COPY . /src` is not in it any more")
    check = next(line for line in lines if line.startswith("HEALTHCHECK")).replace("control/", "/data/control/")
    return f'{text}\n{check}\nCOPY run.py /run.py\nCMD ["python", "/run.py"]\n'


def put_together(folder: Path) -> None:
    """Write the add-on to an empty or new `folder`."""
    if folder.exists() and any(folder.iterdir()):
        raise SystemExit(f"{folder}: is not empty")
    shutil.copytree(ROOT / "addon", folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    if f'version: "{version}"' not in (folder / "config.yaml").read_text(encoding="utf-8"):
        raise SystemExit(f"addon/config.yaml: its version is not that of pyproject.toml, {version}")
    (folder / "Dockerfile").write_text(dockerfile(), encoding="utf-8")
    for name in _SOURCES:
        there, source = folder / "src" / name, ROOT / name
        there.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, there, ignore=shutil.ignore_patterns("__pycache__", "*.pyc"))
        else:
            shutil.copy(source, there)


def main(words: Sequence[str] | None = None) -> None:
    """See the head of this module."""
    given = sys.argv[1:] if words is None else list(words)
    if len(given) != 1:
        raise SystemExit(__doc__)
    put_together(Path(given[0]))
    print(f"{given[0]}: copy it to /addons of Home Assistant, and install it as a local add-on")


if __name__ == "__main__":
    main()
