"""What is installed together is pinned, bounded and told of."""

from __future__ import annotations

import re
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from places import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LISTS = [PROJECT["project"]["dependencies"], *PROJECT["project"]["optional-dependencies"].values()]
REQUIRED = [Requirement(line) for lines in [*LISTS, PROJECT["build-system"]["requires"]] for line in lines]
OWN = "thermoforce-mpc"
# What the constraints leave out: models of hubs, which hold others back (tools/lock.py).
UNPINNED = {"tirex-2", "timesfm", "toto-2", "granite-tsfm"}


def pins(file: str) -> list[Requirement]:
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    return [Requirement(line.split(" \\")[0]) for line in lines if re.match("[A-Za-z0-9]", line)]


def rows() -> dict[str, list[str]]:
    page = (ROOT / "docs" / "reference" / "dependencies.md").read_text(encoding="utf-8")
    table = [line[1:-1].split("|") for line in page.splitlines() if line.startswith("|")][2:]
    return {cells[0]: cells for cells in table}


def test_the_table_has_every_dependency_with_its_licence_reason_size_and_release():
    named = {canonicalize_name(one.name) for one in REQUIRED} - {OWN}
    assert rows().keys() == named
    for cells in rows().values():
        name, _, why, licence, size, version, released, _ = cells
        assert all((why, licence, size, version, released)), name
        assert "?" not in (why, licence, size, version, released), name


@pytest.mark.parametrize("one", REQUIRED, ids=str)
def test_every_requirement_has_an_upper_bound(one):
    assert canonicalize_name(one.name) == OWN or any(part.operator in ("<", "<=", "==") for part in one.specifier), one


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_every_requirement_is_pinned_for_every_python_and_fits_its_bounds(python):
    there = {"python_version": python, "python_full_version": f"{python}.0", "sys_platform": "linux"}
    there |= {"platform_machine": "x86_64", "platform_system": "Linux", "os_name": "posix", "extra": ""}
    pinned = {}
    for pin in pins("constraints.txt"):
        if pin.marker is None or pin.marker.evaluate(there):
            assert pin.name not in pinned, f"{pin.name} has two versions for Python {python}"
            (version,) = (part.version for part in pin.specifier)
            pinned[canonicalize_name(pin.name)] = version
    for one in REQUIRED:
        name = canonicalize_name(one.name)
        if name not in UNPINNED | {OWN}:
            assert one.specifier.contains(pinned.get(name, "0"), prereleases=True), f"{one}: {pinned.get(name)}"
    in_image = {canonicalize_name(pin.name) for pin in pins("requirements.txt")}
    needed = {canonicalize_name(Requirement(line).name) for line in PROJECT["project"]["dependencies"]}
    assert needed - in_image == {"torch"}, "its CPU build comes from another index"


def test_every_pin_has_hashes_and_no_cuda_build_is_among_them():
    for file in ("constraints.txt", "requirements.txt"):
        text = (ROOT / file).read_text(encoding="utf-8")
        blocks = re.split(r"\n(?=[A-Za-z0-9])", text)[1:]
        assert len(blocks) > 50
        assert all(re.search(r"--hash=sha256:[0-9a-f]{64}", block) for block in blocks)
        assert not re.search(r"^(nvidia|cuda|triton)", text, re.M)


def test_what_readme_ci_and_image_install_is_pinned():
    readme, image = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "Dockerfile"))
    installs = re.findall(r"pip install [^`\n&]*", readme)
    assert len(installs) >= 3
    assert all("-c constraints.txt" in line for line in installs)
    assert "--require-hashes -r /src/requirements.txt" in image
    assert "tools.lock --verify" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_ci_finds_what_it_runs_with_the_newest_versions():
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (paths,) = re.findall(r"^met=\((.*?)\)$", ci, re.M | re.S)
    assert '"${met[@]}"' in ci
    assert [path for path in paths.split() if not (ROOT / path).exists()] == []
    assert len(paths.split()) > 10
