"""Write what is installed anew: `constraints.txt` for everybody, `requirements.txt` for the image, and the table of
dependencies.

    python -m tools.lock             (the newest that pyproject.toml allows, from PyPI; takes seconds, needs `uv`)
    python -m tools.lock --newer     (say what is newer than the constraints, for this Python; write nothing)
    python -m tools.lock --verify REPORT.json    (compare the hashes of what pip installed, as its --report says)

`constraints.txt` has a version for every Python and platform, and the hashes of its files in comments: pip takes
hashes only where all that it installs has some, which a checkout and the CPU build of torch have not. `--verify`
compares them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS, IMAGE = ROOT / "constraints.txt", ROOT / "requirements.txt"
PAGE = ROOT / "docs" / "reference" / "dependencies.md"
_OLDEST = "3.11"
# Those of foundation models from hubs are not in it: they hold pandas and torch back.
_LOCKED = ("dev",)
_IMAGE = ("serve", "fmu", "home", "mqtt")
# Of PyPI's builds with CUDA; the CPU build, which README and image name, has none of them.
_LICENCE = re.compile(r"License :: (?!OSI Approved$|Other)")
_CUDA = re.compile(r"(nvidia-|cuda-|triton)")
_HEAD = "# Written by `python -m tools.lock`: what is tested together. For pip's -c; hashes: tools/lock.py --verify.\n"
_HEAD_IMAGE = (
    "# Written by `python -m tools.lock`: what the image holds, for pip's --require-hashes --no-deps.\n"
    "# Left out is torch, whose CPU build comes from another index (Dockerfile).\n"
)


def main(words: Sequence[str] | None = None) -> int:
    """Write the files, or compare; the exit code is 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--newer", action="store_true", help="say what is newer than the constraints, and write nothing")
    how.add_argument("--verify", type=Path, metavar="REPORT", help="compare hashes with those of pip's --report")
    given = parser.parse_args(words)
    if given.verify:
        return _verified(given.verify)
    if given.newer:
        found, pinned = dict(_pins(_compiled(_LOCKED, "--no-annotate"))), dict(_pins(CONSTRAINTS.read_text()))
        newer = {name: version for name, version in found.items() if pinned.get(name) != version}
        print("\n".join(f"{name}=={version}" for name, version in sorted(newer.items())))
        return 1 if newer else 0
    CONSTRAINTS.write_text(_HEAD + _commented(_compiled(_LOCKED, "--generate-hashes", "--no-annotate")))
    IMAGE.write_text(_HEAD_IMAGE + _without(_compiled(_IMAGE, "--generate-hashes", "--no-annotate"), "torch"))
    PAGE.write_text(_page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(f"wrote {CONSTRAINTS.name}, {IMAGE.name} and {PAGE.relative_to(ROOT)}")
    return 0


def _compiled(extras: Sequence[str], *options: str) -> str:
    """The newest versions that pyproject.toml allows, for every Python and platform, by `uv`, from PyPI alone."""
    command = [
        _uv(),
        "pip",
        "compile",
        "--quiet",
        "--universal",
        "--python-version",
        _OLDEST,
        "--no-header",
        "--no-config",
    ]
    named = [word for extra in extras for word in ("--extra", extra)]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [*command, *options, *named, str(ROOT / "pyproject.toml"), "--output-file", f"{folder}/found.txt"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            raise SystemExit(done.stderr)
        return Path(folder, "found.txt").read_text()


def _uv() -> str:
    """`uv` of this environment, else of this machine."""
    found = shutil.which("uv", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")
    if found is None:
        raise SystemExit("uv is not installed: pip install -c constraints.txt -e '.[dev]'")
    return found


def _blocks(text: str) -> Iterator[str]:
    """Requirements with their hashes, those of CUDA builds and this package left out."""
    for block in re.split(r"\n(?=[A-Za-z0-9])", text.strip()):
        if not _CUDA.match(block) and not block.startswith("thermoforce-mpc"):
            yield block


def _commented(text: str) -> str:
    """Requirements, each followed by its hashes in comments."""
    lines = []
    for block in _blocks(text):
        requirement, *hashes = (line.strip(" \\") for line in block.splitlines())
        lines += [requirement, *(f"#   {one}" for one in hashes)]
    return "\n".join(lines) + "\n"


def _without(text: str, name: str) -> str:
    return "\n".join(block for block in _blocks(text) if not block.startswith(f"{name}==")) + "\n"


def _pins(text: str) -> Iterator[tuple[str, str]]:
    """Name and version of what the constraints have for this Python and platform."""
    for line in text.splitlines():
        if re.match("[A-Za-z0-9]", line) and not _CUDA.match(line):
            requirement = Requirement(line.split(" \\")[0])
            if requirement.marker is None or requirement.marker.evaluate():
                yield canonicalize_name(requirement.name), next(iter(requirement.specifier)).version


def _verified(report: Path) -> int:
    """Say which files that pip installed have another hash than the constraints, and which have none there."""
    known: dict[str, set[str]] = {}
    name = ""
    for line in CONSTRAINTS.read_text().splitlines():
        if match := re.match(r"([A-Za-z0-9._-]+)==", line):
            name = canonicalize_name(match[1])
        elif match := re.match(r"#\s+--hash=sha256:(\w+)", line):
            known.setdefault(name, set()).add(match[1])
    others, wrong, n = [], [], 0
    for one in json.loads(report.read_text())["install"]:
        name = canonicalize_name(one["metadata"]["name"])
        found = one["download_info"].get("archive_info", {}).get("hashes", {}).get("sha256", "")
        if found in known.get(name, ()):
            n += 1
        elif found and "files.pythonhosted.org" in one["download_info"]["url"]:
            wrong.append(f"{name}: {one['download_info']['url']} has sha256 {found}, which {CONSTRAINTS.name} has not")
        else:
            others.append(name)
    print(
        *wrong,
        f"{n} files have the hashes of {CONSTRAINTS.name}; not compared: {', '.join(others) or 'none'}",
        sep="\n",
    )
    return 1 if wrong else 0


def required() -> dict[str, str]:
    """What pyproject.toml requires by name, and in which extra; '' for all installations."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lists = {"": project["dependencies"], **project["optional-dependencies"]}
    found: dict[str, str] = {}
    for extra, lines in lists.items():
        for line in lines:
            if (name := canonicalize_name(Requirement(line).name)) != "thermoforce-mpc":
                found.setdefault(name, extra)
    return found


def _page(text: str) -> str:
    """The page with the columns of the table that are measured renewed: licence, size; a row that lacks is added."""
    head, _, rest = text.partition("<!-- table -->\n")
    table, _, tail = rest.partition("<!-- end -->\n")
    said = {}
    for line in table.splitlines()[2:]:
        cells = [cell.strip() for cell in line[1:-1].split("|")]
        said[cells[0]] = cells
    pinned = dict(_pins(CONSTRAINTS.read_text()))
    lines = ["|package|extra|for|licence|MB|version|released|on import|", "|---|---|---|---|---|---|---|---|"]
    needed = required()
    released = _released({name: pinned[name] for name in needed if name in pinned})
    for name, extra in needed.items():
        old = said.get(name, [name, extra, "?", "?", "?", "?", "?", ""])
        licence, size = _measured(name) or (old[3], old[4])
        licence = licence if old[3] == "?" else old[3]  # many packages state theirs in other words
        version, date = pinned.get(name, old[5]), released.get(name, old[6])
        lines.append(f"|{'|'.join((name, extra, old[2], licence, size, version, date, old[7]))}|")
    return f"{head}<!-- table -->\n" + "\n".join(lines) + f"\n<!-- end -->\n{tail}"


def _released(pinned: Mapping[str, str]) -> dict[str, str]:
    """Month in which each version was released, by `uv lock`."""
    with tempfile.TemporaryDirectory() as folder:
        pins = [f"{name}=={version}" for name, version in pinned.items()]
        project = {
            "name": "pinned",
            "version": "0",
            "requires-python": f"=={'.'.join(platform.python_version_tuple()[:2])}.*",
        }
        lines = [f"{key} = {json.dumps(value)}" for key, value in {**project, "dependencies": pins}.items()]
        Path(folder, "pyproject.toml").write_text("\n".join(["[project]", *lines]))
        done = subprocess.run(
            [_uv(), "lock", "--quiet", "--no-config", "--project", folder], capture_output=True, text=True
        )
        if done.returncode:
            raise SystemExit(done.stderr)
        packages = tomllib.loads(Path(folder, "uv.lock").read_text())["package"]
    dates = {
        one["name"]: [file["upload-time"] for file in one.get("wheels", ()) if "upload-time" in file]
        for one in packages
    }
    return {name: str(min(found))[:7] for name, found in dates.items() if found}


def _measured(name: str) -> tuple[str, str] | None:
    """Licence, as the installed package states it, and its size on disk, MB; None where it is not installed."""
    try:
        found = distribution(name)
    except PackageNotFoundError:
        return None
    size = sum(
        Path(str(file.locate())).stat().st_size for file in found.files or () if Path(str(file.locate())).is_file()
    )
    stated = found.metadata["License-Expression"] or next(
        (
            one.rpartition(":: ")[2]
            for one in found.metadata.get_all("Classifier") or ()
            if one.startswith("License ::")
        ),
        (found.metadata["License"] or "?").strip().partition("\n")[0][:30],
    )
    return stated.replace(" License", "").replace("|", "/"), f"{size / 1e6:.1f}" if size < 1e7 else f"{size / 1e6:.0f}"


if __name__ == "__main__":
    sys.exit(main())
