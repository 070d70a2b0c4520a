"""`tf-mpc init`, `schema` and `validate`: YAML files to start from, their schemas, and whether they are valid.

Files to start a real building from come with comments: connection, map, and what gives the building back without us.
"""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from thermoforce_mpc.cli.options import PATH, code_option
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import storage_errors, write_whole

if TYPE_CHECKING:
    from pydantic import BaseModel

    from thermoforce_mpc.scenario.scenario import Scenario

HOMES = ("home-assistant", "mqtt", "files", "boptest")
"""What `tf-mpc init --for` knows; boptest is a scenario."""


_SCHEMAS = "schema"
_DEFAULT = "bestest_hydronic_heat_pump"
# Widest comment of a scenario.
_WIDTH = 110
# A key that only files of this kind have; any other file is a scenario.
_KIND_OF = {
    "buildings": "fleet", "variants": "comparison", "outdoor": "map", "actuator": "testcase", "zones": "testcase",
    "measurements": "testcase", "source": "bill", "energy": "bill", "peak": "bill", "grid": "bill",
}  # fmt: skip


@click.command()
@click.argument("folder", metavar="[DIR]", default=".", type=PATH)
@click.option(
    "--testcase", help="Building of the scenario; of a service, a name there.  [default: bestest_hydronic_heat_pump]"
)
@click.option("--copy-testcase", is_flag=True, help="Copy that test case to testcase.yaml, to make it yours.")
@click.option("--data", metavar="FILE", help="Write map.yaml too, guessed from this table of measurements.")
@click.option("--zone", help="With --data: the building's time zone, as Europe/Brussels.")
@click.option("--from-url", metavar="URL", help="Write testcase.yaml, proposed from the points of a BOPTEST service.")
@click.option("--for", "home", type=click.Choice(HOMES), help="Of a real building behind this, or a BOPTEST service.")
def init(
    folder: Path, testcase: str | None, copy_testcase: bool, data: str | None, zone: str | None, from_url: str | None,
    home: str | None,
) -> None:  # fmt: skip
    """Write a commented scenario to DIR, with every key, its meaning and its default, ready to run.

    With --for the files of a real building: map.yaml, connection.yaml, a systemd unit, and for Home Assistant the timer
    and automation that give the house back without us. With --for boptest the scenario of a service.

    Nothing is overwritten. The schemas of the files are written beside them, so that editors complete keys.

    \b
    Examples:
      tf-mpc init my_study
      tf-mpc init my_house --testcase bestest_hydronic --copy-testcase
      tf-mpc init my_house --data house.csv --zone Europe/Brussels
      tf-mpc init my_study --testcase my_office --from-url http://127.0.0.1:8000
      tf-mpc init my_house --for home-assistant
    """
    from thermoforce_mpc.measurements.map.starting_map import doubt_of_zone, starting_map
    from thermoforce_mpc.plants.testcases import is_read, load_scenario, load_testcase
    from thermoforce_mpc.scenario.settings import find_config

    if zone is not None and data is None:
        raise ConfigError("--zone: is of the map that --data writes; give a table of measurements, or leave it out")
    if from_url is not None:
        if copy_testcase or data is not None or home is not None:
            raise ConfigError("--from-url: writes a test case itself; leave --copy-testcase, --data and --for out")
        _init_of_service(folder, testcase or _DEFAULT, from_url)
        return
    if home not in (None, "boptest"):
        if copy_testcase:
            raise ConfigError(f"--for {home}: a real building has no test case to copy")
        if testcase is not None:
            raise ConfigError(
                f"--testcase: --for {home} is a real building, which is no test case; leave one of them out"
            )
        texts = home_files(home, None if data is None else starting_map(data, zone))
        texts["map.yaml"] = _headed("map", texts["map.yaml"])
        _write_new({folder / name: text for name, text in texts.items()}, _schemas(folder, ["map"]))
        for name in texts:
            click.echo(f"Wrote {folder / name}")
        if data is not None and (doubt := doubt_of_zone(texts["map.yaml"])):
            click.echo(doubt)
        first = "" if folder == Path() else f"cd {shlex.quote(str(folder))} && "
        click.echo(f"Replace the names in them, then: {first}tf-mpc validate map.yaml")
        click.echo("Then: tf-mpc commission connection.yaml")
        return
    testcase = testcase or _DEFAULT
    building = load_testcase(testcase)
    implemented = building.embedded or building.energyplus or building.plant
    reference = str(Path(testcase).absolute()) if Path(testcase).suffix in (".yaml", ".yml") else testcase
    overrides = {"testcase": "testcase.yaml" if copy_testcase else reference}
    plant = {"kind": "embedded" if implemented and home is None else "boptest"}
    if home == "boptest":
        plant["url"] = "http://127.0.0.1:80"
    scenario = load_scenario(None, overrides | {"testcase": testcase, "plant": plant})
    texts = {"scenario": _headed("scenario", scenario_text(scenario.model_copy(update=overrides)))}
    if copy_testcase:
        if building.name == testcase and not is_read(testcase):
            raise ConfigError(f"--copy-testcase: '{testcase}' is made, not read from a file; leave the option out")
        path = find_config("testcases", testcase.replace("energyplus:", "energyplus_", 1))
        texts["testcase"] = _headed("testcase", path.read_text(encoding="utf-8"))
    if data is not None:
        texts["map"] = _headed("map", starting_map(data, zone))
    enter = _written(folder, texts)
    if doubt := doubt_of_zone(texts.get("map", "")):
        click.echo(doubt)
    what = " (the simulated test case, not your measurements)" if data is not None else ""
    click.echo(f"Run it:   {enter}tf-mpc run --config scenario.yaml{what}")
    if not implemented and home is None:
        click.echo("The plant is a BOPTEST service: set plant.url, or plant.kind: fmu and plant.path.")
    if data is not None:
        table = shlex.quote(str(Path(data).absolute()))
        click.echo(f"Check it: {enter}tf-mpc data check {table} --map map.yaml")


def _init_of_service(folder: Path, testcase: str, url: str) -> None:
    """Write a test case proposed from the points of a service, and a scenario that runs it there."""
    from thermoforce_mpc.plants.boptest.proposal import points_of_service, proposed_testcase
    from thermoforce_mpc.plants.testcases import load_scenario
    from thermoforce_mpc.scenario.settings import parse_yaml, validate
    from thermoforce_mpc.scenario.testcase import TestCase

    proposed = proposed_testcase(testcase, points_of_service(url, testcase))
    validate(TestCase, parse_yaml(proposed.encode(), folder / "testcase.yaml"), "proposed test case")
    overrides = {"testcase": "testcase.yaml", "plant": {"kind": "boptest", "url": url}}
    scenario = load_scenario(None, overrides)
    texts = {"scenario": _headed("scenario", scenario_text(scenario)), "testcase": _headed("testcase", proposed)}
    enter = _written(folder, texts)
    click.echo(f"Look at the {proposed.count('CHECK') - 1} lines with CHECK in testcase.yaml, then")
    click.echo(f"Run it:   {enter}tf-mpc run --config scenario.yaml")


def _written(folder: Path, texts: Mapping[str, str]) -> str:
    """Write files of these kinds and their schemas to a folder, say so, and return the words that enter it."""
    _write_new({folder / f"{kind}.yaml": text for kind, text in texts.items()}, _schemas(folder, texts))
    for kind in texts:
        click.echo(f"Wrote {folder / kind}.yaml")
    return "" if folder == Path() else f"cd {shlex.quote(str(folder))} && "


def _schemas(folder: Path, kinds: Iterable[str]) -> dict[Path, str]:
    """Schemas of files of these kinds in a folder, where the first lines of the files name them."""
    from thermoforce_mpc.cli.inside.schemas import schema_text

    return {folder / _SCHEMAS / f"{kind}.json": schema_text(kind) for kind in kinds}


def _write_new(files: Mapping[Path, str], beside: Mapping[Path, str]) -> None:
    """Write `files`, and those `beside` them; raises `ConfigError` where one of `files` is there already."""
    if existing := [str(path) for path in files if path.exists()]:
        raise ConfigError(f"{', '.join(existing)}: there already, and never overwritten; choose another folder")
    for path, text in {**files, **beside}.items():
        with storage_errors(path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)


def _headed(kind: str, text: str) -> str:
    lines = [line for line in text.splitlines() if not re.match(r"#\s*yaml-language-server:", line)]
    return "\n".join([f"# yaml-language-server: $schema={_SCHEMAS}/{kind}.json", *lines]) + "\n"


@click.command()
@click.argument("kind", metavar="scenario|testcase|comparison|fleet|map")
@click.option("--out", type=PATH, help="File to write to.  [default: print it]")
def schema(kind: str, out: Path | None) -> None:
    """Write the JSON Schema of a kind of file: scenario, testcase, comparison, fleet, or map (of
    measurements).

    An editor with a YAML language server completes and checks a file whose first line names its schema:

    \b
      # yaml-language-server: $schema=scenario.json

    `tf-mpc init` writes files that do. Options of controllers are in it; what several keys must fulfil together is
    checked by `tf-mpc validate` alone.

    \b
    Example:
      tf-mpc schema scenario --out scenario.json
    """
    from thermoforce_mpc.cli.inside.schemas import schema_text

    text = schema_text(kind)
    if out is None:
        click.echo(text, nl=False)
        return
    write_whole(out, text)
    click.echo(f"Schema: {out}")


@click.command()
@click.argument("file", type=PATH)
@code_option
def validate_file(file: Path, code: tuple[str, ...]) -> None:
    """Check FILE, a scenario, test case, comparison, fleet, map, bill or connection; an error names file, key, values.

    A comparison has the key `variants`, a fleet `buildings`, a map `outdoor`, a test case `actuator`, `zones` or
    `measurements`, a bill `source`. Of a scenario, weather, prices, model and forecaster are loaded too. Whether a map
    fits a table is said by `tf-mpc data check`. Exit code 2 when it is invalid.

    Python that the file names is looked at and not run: whether it has what is named, and what it would import. With
    --code it is run, and the options of what it defines are checked. A forecaster on a hub is not fetched.
    """
    from thermoforce_mpc.cli.inside.schemas import KINDS
    from thermoforce_mpc.experiment.experiment import Experiment, check_contestants
    from thermoforce_mpc.experiment.outside import HUB, outside
    from thermoforce_mpc.plants.registry import check_surroundings
    from thermoforce_mpc.scenario.bill import Bill
    from thermoforce_mpc.scenario.scenario import Scenario
    from thermoforce_mpc.scenario.settings import read_yaml, validate

    data = read_yaml(file)
    if set(data) == {"name", "options"}:
        from thermoforce_mpc.connections.registry import build_connection, connection_settings

        name, options = connection_settings(str(file), {})
        build_connection(name, options).close()
        click.echo(f"{file}: valid connection, {name}")
        return
    kind = next((kind for key, kind in _KIND_OF.items() if key in data), "scenario")
    if kind != "scenario":
        of_kind: dict[str, type[BaseModel]] = {**KINDS, "bill": Bill}
        content = validate(of_kind[kind], data, str(file)).model_dump()
        variants = [{"controller": {"name": one["controller"], **one}} for one in content.get("variants", {}).values()]
        _look([content.get("scenario", {}), *variants], code)
        click.echo(f"{file}: valid {kind}")
        return
    scenario = validate(Scenario, data, str(file))
    unread = _look([scenario.model_dump()], code)
    on_hub = [one.value for one in outside(scenario) if one.key == HUB]
    for name in on_hub:
        click.echo(f"{name}: not looked at; a hub is asked for it when it is run")
    experiment = Experiment.of(_without(scenario, unread, hub=bool(on_hub)))
    check_surroundings(scenario.plant)
    check_contestants(experiment)
    click.echo(f"{file}: valid scenario, {scenario.controller.name} on {scenario.testcase}, {scenario.period}")


def _without(scenario: Scenario, unread: Collection[str], *, hub: bool) -> Scenario:
    """A scenario without what is in files of code that are not run, and with the default in place of a hub's model."""
    from controllers.registry import find_entry
    from thermoforce_mpc.scenario.own_code import code_file
    from thermoforce_mpc.scenario.settings import validate

    keys = scenario.model_dump(exclude_unset=True)
    for key in ("baselines", "kpis"):
        keys[key] = [name for name in getattr(scenario, key) if code_file(name) not in unread]
    if code_file(scenario.controller.name) in unread:
        keys["controller"] = {"name": "native"}
        # They would need the model that this controller is identified for.
        keys["baselines"] = [name for name in keys["baselines"] if not find_entry(name).needs_model]
    elif options := dict(scenario.controller.options):
        if code_file(str(options.get("terms"))) in unread:
            del options["terms"]
        if hub:
            del options["free_response"]
        keys["controller"]["options"] = options
    return validate(type(scenario), keys, "scenario")


def _look(scenarios: Iterable[Mapping[str, Any]], given: Collection[str]) -> set[str]:
    """Say what is in the Python that keys of scenarios name, and return its files, but for those `given` to be run."""
    from thermoforce_mpc.experiment.outside import own_names
    from thermoforce_mpc.scenario.own_code import code_file, is_own_code, looked_at

    may_run, unread = {Path(name).resolve() for name in given}, set[str]()
    for name in dict.fromkeys(name for keys in scenarios for name in own_names(keys)):
        if (path := code_file(name)) is None or Path(path).resolve() in may_run:
            continue
        holds = looked_at(name, "code", ConfigError) if is_own_code(name) else "a policy, which is unpickled"
        if path not in unread:
            click.echo(f"{path}: {holds}. Not run; --code {shlex.quote(path)} runs it, and checks its options")
        unread.add(path)
    return unread


def scenario_text(scenario: Scenario) -> str:
    """The scenario as YAML: keys without a value stand in comments, with an example of one."""
    return "\n".join(_lines(scenario, "")) + "\n"


def _lines(model: BaseModel, margin: str) -> Iterator[str]:
    for key, field in type(model).model_fields.items():
        value = getattr(model, key)
        if not margin:
            yield ""
        if hasattr(type(value), "model_fields"):
            yield from _comment((type(value).__doc__ or "").partition("\n")[0], margin)
            yield f"{margin}{key}:"
            yield from _lines(value, margin + "  ")
            continue
        yield from _comment(field.description or "", margin)
        if value is None or value == {}:
            yield f"{margin}# {key}: {_flow(field.examples[0] if field.examples else value)}"
        else:
            yield f"{margin}{key}: {_flow(list(value) if isinstance(value, tuple) else value)}"


def _comment(words: str, margin: str) -> Iterator[str]:
    start = f"{margin}# "
    yield from textwrap.wrap(words, _WIDTH, initial_indent=start, subsequent_indent=start)


def _flow(value: Any) -> str:
    import yaml

    text = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, width=1000)
    return text.removesuffix("...\n").strip()


_MAP = """\
# Which signal is what, in which unit: docs/reference/map.md. Replace the names; `tf-mpc validate map.yaml`
# checks the rest.
time: {{zone: Europe/Berlin}}        # of schedules and of stamps without an offset
step: 15min
{table}outdoor: {outdoor}
zones:
  hall:
    temperature: {temperature}
    floor_area_m2: 100
comfort: "weekdays 6:00-22:00 20.5-23, else 19-24"   # °C; holidays: [2026-12-25] counts them as Sundays
actuators:
  heat_pump:
    level: {level}
    command:
      kind: setpoint
      column: {setpoint}
      resolution: 0.5
      minimum: 17
      maximum: 24
      hold_min: 30
machines:
  heat_pump: {{power: {power}}}      # W; unit: kW, or Wh counter, …
# Columns of the forecast that connection.yaml asks for:
forecast: {{outdoor: temperature_C, sun: solar_W_m2, price: price_per_kWh}}
"""
_FORECAST = """\
  forecast:                            # nobody is asked but who is named here: docs/how-to/forecasts.md
    weather: {name: open-meteo, options: {latitude: 52.5, longitude: 13.4}}
    prices: {name: awattar, factor: 1.19, add_per_kWh: 0.15}   # or a price in the map
"""
_HOME_ASSISTANT = """\
# tf-mpc control --connection connection.yaml; options: `tf-mpc connections home-assistant`.
# The token (profile page, long-lived access token) stands in HOME_ASSISTANT_TOKEN, or in a file of mode 600:
name: home-assistant
options:
  url: http://homeassistant.local:8123   # in an add-on http://supervisor/core
  # token_file: token
  watchdog: timer.tf_mpc                 # of package.yaml: gives the house back when nothing comes any more
  actuators:                             # names as in map.yaml
    heat_pump: {entity: climate.hall, release: 20}   # release: set-point when it is given back
    # curve: {entity: number.curve_offset, release: 0}
    # pump: {entity: select.sg_ready, release: normal, options: {1: blocked, 2: normal, 3: recommended}}
"""
_PACKAGE = """\
# For Home Assistant: /config/packages/tf_mpc.yaml, with `homeassistant: {packages: !include_dir_named packages}`.
# Each command starts the timer anew, for as long as it holds. Where none comes any more (this program, its machine or
# the network is gone) the timer ends, and the automation gives the house back; the same after a restart.
timer:
  tf_mpc: {restore: true}
automation:
  - alias: Give the heating back
    triggers:
      - {trigger: event, event_type: timer.finished, event_data: {entity_id: timer.tf_mpc}}
    actions:
      - {action: climate.set_temperature, target: {entity_id: climate.hall}, data: {temperature: 20}}
"""
_MQTT = """\
# tf-mpc control --connection connection.yaml; options: `tf-mpc connections mqtt`.
# The password stands in MQTT_PASSWORD, or in a file of mode 600:
name: mqtt
options:
  host: localhost
  user: house
  # password_file: password
  # tls: true                            # and ca_file, where the broker's certificate is of an authority of your own
  version: "5"                           # or "3.1.1", without expiry of commands
  record: mqtt.csv                       # what comes is appended: `tf-mpc record` begins it some weeks before
  actuators:                             # names as in map.yaml
    heat_pump:
      topic: zigbee2mqtt/hall/set
      payload: '{"occupied_heating_setpoint": $value}'
      release: 20                        # set-point when it is given back
      state: zigbee2mqtt/hall#occupied_heating_setpoint   # what the device says that it took
"""
_FILES = """\
# tf-mpc control --connection connection.yaml; options: `tf-mpc connections files`.
name: files
options:
  measurements: house.csv                # which something appends to; or a pattern, as data/*.csv
  levels: levels.json                    # which something sets the machine by; null or past `until`: its own control
"""
_NAMES = {
    "home-assistant": {
        "table": "", "outdoor": "sensor.outdoor_temperature", "temperature": "climate.hall.current_temperature",
        "level": '{column: sensor.heat_pump_speed, unit: "%"}', "setpoint": "climate.hall.temperature",
        "power": "sensor.heat_pump_power",
    },
    "mqtt": {
        "table": "table: {point: topic, value: value}   # of mqtt.csv\n", "outdoor": "weather/outdoor",
        "temperature": '"zigbee2mqtt/hall#local_temperature"', "level": "heatpump/level",
        "setpoint": '"zigbee2mqtt/hall#occupied_heating_setpoint"', "power": "heatpump/power",
    },
    "files": {
        "table": "", "outdoor": "outdoor_C", "temperature": "hall_C", "level": "heat_pump_level",
        "setpoint": "hall_setpoint_C", "power": "heat_pump_W",
    },
}  # fmt: skip
_SERVICE = """\
# For systemd: copy it to /etc/systemd/system/tf-mpc.service, then `systemctl enable --now tf-mpc`.
# A secret stands in /etc/tf-mpc.env (mode 600), as HOME_ASSISTANT_TOKEN=… or MQTT_PASSWORD=…
[Unit]
Description=ThermoForce MPC
Wants=network-online.target
After=network-online.target time-sync.target

[Service]
User=tf-mpc
WorkingDirectory=/var/lib/tf-mpc
StateDirectory=tf-mpc
EnvironmentFile=-/etc/tf-mpc.env
ExecStart=/opt/tf-mpc/bin/tf-mpc control --model my_house --map map.yaml --connection connection.yaml
# With --page 127.0.0.1:8010 it has a page (extra serve); 0.0.0.0:8010 with TF_MPC_PAGE_TOKEN=… in that file.
# SIGTERM gives the building back, in up to five attempts.
TimeoutStopSec=90
Restart=always
RestartSec=60
# Wrong files and options do not get better by themselves.
RestartPreventExitStatus=2
MemoryMax=1G
NoNewPrivileges=true
ProtectSystem=strict
ProtectHome=true
PrivateTmp=true
PrivateDevices=true
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX

[Install]
WantedBy=multi-user.target
"""


def home_files(kind: str, map_text: str | None) -> dict[str, str]:
    """Texts by name of file of a real building behind `kind`; `map_text`: in the place of the example's map."""
    connection = {"home-assistant": _HOME_ASSISTANT, "mqtt": _MQTT, "files": _FILES}[kind]
    files = {
        "map.yaml": _MAP.format(**_NAMES[kind]) if map_text is None else map_text,
        "connection.yaml": connection + _FORECAST,
        "tf-mpc.service": _SERVICE,
    }
    if kind == "home-assistant":
        files["package.yaml"] = _PACKAGE
    return files
