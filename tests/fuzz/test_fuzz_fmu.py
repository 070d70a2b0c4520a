"""FMU archives of strangers: bombs, names that lead elsewhere, damage; reading one never runs it."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc
import zipfile
from pathlib import Path

import pytest
from fuzzing import VALUES, fuzz, mutated, result_or_error, tampered
from hypothesis import given
from hypothesis import strategies as st

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.fmu.archive import FmuArchive, read_archive, unpack

fmpy = pytest.importorskip("fmpy")

XML = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="wrapped" guid="{1}" generationTool="a hand">
<CoSimulation modelIdentifier="wrapped"/>
<DefaultExperiment startTime="0" stopTime="1" tolerance="1e-6"/>
<ModelVariables>
<ScalarVariable name="oveTSet_u" valueReference="1" causality="input" description="Set-point">
<Real unit="K" min="278.15" max="308.15"/></ScalarVariable>
<ScalarVariable name="reaTRoo_y" valueReference="2" causality="output"><Real unit="K"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>
"""
BINARY = f"binaries/{fmpy.platform}/wrapped{fmpy.sharedLibraryExtension}"
TABLE = b"time,TDryBul\n" + b"".join(b"%d,%d\n" % (900 * i, 270 + i % 20) for i in range(100))
CONFIG = {"name": "a house", "area": 192.0, "resource_file_exclusion": []}
MEMBERS = {
    "modelDescription.xml": XML,
    BINARY: b"\x7fELF, or so it says",
    "resources/weather.csv": TABLE,
    "resources/kpis.json": json.dumps({"ElectricPower": ["reaTRoo_y"]}).encode(),
    "resources/days.json": b'{"peak_heat_day": 23}',
    "resources/config.json": json.dumps(CONFIG).encode(),
}


def zipped(members: dict[str, bytes], kind: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", kind) as file:
        for name, content in members.items():
            # Always the same time, so that every run tries the same examples.
            file.writestr(zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, 0)), content, compress_type=kind)
    return buffer.getvalue()


@pytest.fixture
def written(tmp_path):
    def write(content: bytes) -> Path:
        (tmp_path / "x.fmu").write_bytes(content)
        return tmp_path / "x.fmu"

    return write


def read(path: Path) -> FmuArchive | None:
    return result_or_error(ConfigError, lambda: read_archive(path), names="x.fmu")


def test_a_plain_one_is_read_and_unpacked_to_its_folder(written, tmp_path):
    archive = read_archive(written(zipped(MEMBERS)))
    assert (list(archive.inputs), list(archive.outputs), archive.area_m2) == (["oveTSet_u"], ["reaTRoo_y"], 192.0)
    (tmp_path / "fmu").mkdir()
    unpack(archive, tmp_path / "fmu")
    assert {str(path.relative_to(tmp_path / "fmu")) for path in tmp_path.rglob("fmu/**/*") if path.is_file()} == set(
        MEMBERS
    )


@pytest.mark.parametrize(
    "name",
    ["../evil.so", "resources/../../evil", "/etc/cron.d/evil", "C:evil", "resources\\..\\evil", "a\nb", "x" * 1001],
)
def test_a_name_that_leads_elsewhere_is_refused(written, name):
    with pytest.raises(ConfigError, match=r"x\.fmu: member .* leads out of the folder"):
        read_archive(written(zipped(MEMBERS | {name: b"x"})))


def test_a_name_twice_is_refused(written):
    buffer = io.BytesIO(zipped(MEMBERS))
    with zipfile.ZipFile(buffer, "a") as file, pytest.warns(UserWarning, match="Duplicate name"):
        file.writestr(BINARY, b"another")
    with pytest.raises(ConfigError, match="two members have the same name"):
        read_archive(written(buffer.getvalue()))


def test_a_file_that_was_exchanged_after_it_was_read_is_not_unpacked(written, tmp_path):
    archive = read_archive(written(zipped(MEMBERS)))
    written(zipped(MEMBERS | {BINARY: b"another"}))
    with pytest.raises(ConfigError, match="was changed while it was read"):
        unpack(archive, tmp_path)
    assert not (tmp_path / "binaries").exists()


def _bomb(**sizes: int) -> bytes:
    """Members of zeros, each as long as told, of which the zip file holds a thousandth."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, content in MEMBERS.items():
            file.writestr(name, content)
        for name, size in sizes.items():
            with file.open(f"resources/{name}.csv", "w") as member:
                for _ in range(size // 1_000_000):
                    member.write(b"0" * 1_000_000)
    return buffer.getvalue()


def _with_size(content: bytes, size: int) -> bytes:
    """The last member says that it has `size` bytes when unpacked."""
    at = content.rfind(b"PK\x01\x02")
    return content[: at + 24] + struct.pack("<I", size) + content[at + 28 :]


def _entities() -> bytes:
    laughs = b"<!DOCTYPE x [<!ENTITY a 'lol'>" + b"".join(
        b"<!ENTITY %c '&%c;&%c;&%c;&%c;&%c;&%c;&%c;&%c;&%c;'>" % (i + 1, *[i] * 9) for i in range(97, 110)
    )
    return XML.replace(b"<fmiModel", laughs + b"]><fmiModel", 1).replace(b"a hand", b"&n;")


def _outside() -> bytes:
    return XML.replace(b"<fmiModel", b"<!DOCTYPE x [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><fmiModel", 1)


BOMBS = {
    "unpacked": (lambda: _with_size(_bomb(zeros=1_000_000), 0xFFFFFFF0), "bytes when unpacked; at most 2,000,000,000"),
    "one table": (lambda: _bomb(zeros=101_000_000), r"zeros\.csv has 101,000,000 bytes; at most 100,000,000 are read"),
    "a size that lies": (lambda: _with_size(_bomb(zeros=250_000_000), 10), r"zeros\.csv cannot be read \(Bad CRC"),
    "a line": (lambda: _bomb(zeros=20_000_000), "line 1 has more than 20,000 bytes"),
    "rows": (lambda: zipped(MEMBERS | {"resources/x.csv": b"time\n" * 1_100_000}), "more than 1,051,202 rows"),
    "members": (lambda: zipped(MEMBERS | {f"{i}": b"" for i in range(20_001)}, zipfile.ZIP_STORED), "20,007 members"),
    "names": (
        lambda: zipped({f"{i}" + "x" * 900: b"" for i in range(5_000)}, zipfile.ZIP_STORED),
        "its list of members is longer than 4,000,000 bytes",
    ),
    "another packer": (lambda: zipped(MEMBERS, zipfile.ZIP_LZMA), "packed by another method"),
    "laughs": (lambda: zipped(MEMBERS | {"modelDescription.xml": _entities()}), "declares a document type"),
    "files of others": (lambda: zipped(MEMBERS | {"modelDescription.xml": _outside()}), "declares a document type"),
    "deep XML": (
        lambda: zipped(MEMBERS | {"modelDescription.xml": XML.replace(b"</fmi", b"<a>" * 10**6 + b"</fmi")}),
        "cannot be used",
    ),
    "deep JSON": (lambda: zipped(MEMBERS | {"resources/kpis.json": b"[" * 10**6}), "kpis.json.* not valid JSON|bytes"),
    "long JSON": (lambda: zipped(MEMBERS | {"resources/kpis.json": b" " * 10**7}), "kpis.json has 10,000,000 bytes"),
}


@pytest.mark.slow
@pytest.mark.parametrize("bomb", BOMBS)
def test_a_bomb_costs_little_memory(written, bomb):
    make, message = BOMBS[bomb]
    path = written(make())
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match=message):
            read_archive(path)
        assert tracemalloc.get_traced_memory()[1] < 60e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_bytes_that_were_changed(written, tmp_path, kind):
    (tmp_path / "fmu").mkdir()

    @fuzz(80)
    @given(content=mutated(zipped(MEMBERS, kind)))
    def check(content):
        archive = read(written(content))
        if archive is not None:
            result_or_error(ConfigError, lambda: unpack(archive, tmp_path / "fmu"))

    check()
    assert {path.name for path in tmp_path.iterdir()} == {"x.fmu", "fmu"}


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MEMBERS if name != BINARY])
def test_a_member_that_was_changed(written, name):
    @fuzz(50)
    @given(content=mutated(MEMBERS[name]))
    def check(content):
        read(written(zipped(MEMBERS | {name: content}, zipfile.ZIP_STORED)))

    check()


@fuzz(60)
@given(
    name=st.sampled_from(["kpis.json", "days.json", "config.json"]),
    document=VALUES | tampered(CONFIG) | st.dictionaries(st.sampled_from(["peak_heat_day", "area", "name"]), VALUES),
)
def test_resources_of_any_content(tmp_path_factory, name, document):
    path = tmp_path_factory.getbasetemp() / "x.fmu"
    try:
        content = json.dumps(document).encode("utf-8", "surrogatepass")
    except ValueError:
        return  # an integer of more digits than Python writes
    path.write_bytes(zipped(MEMBERS | {f"resources/{name}": content}, zipfile.ZIP_STORED))
    read(path)
