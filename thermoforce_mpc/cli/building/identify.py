"""`tf-mpc identify` and `inspect`: a model of a plant or of measurements, identified, printed and saved; a saved one.

What is printed of a model: its parameters, certificate, scores and data ranges.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.table import Table

from thermoforce_mpc.cli.options import PATH, FiniteRange, base_options, probed_option, scenario_from, window_options
from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.files import check_writable
from thermoforce_mpc.report.whole_tables import plain_table

if TYPE_CHECKING:
    from rich.console import Console

    from thermoforce_mpc.data import Record
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.model.card import ModelCard
    from thermoforce_mpc.model.machine.power import PowerModel
    from thermoforce_mpc.model.operator.parameters import OperatorParameters
    from thermoforce_mpc.model.thermal_model import ThermalModel
    from thermoforce_mpc.report.display import RunDisplay


# Exit code of a model that was identified and saved but is not competent.
NOT_COMPETENT = 4
_PROBE = "`tf-mpc data probe-plan` writes the cheapest probing by hand that would tell the effect of acting."
# Options that make no sense with measurements.
_OF_PLANTS = (
    "testcase", "config", "period", "days", "price", "url", "fmu", "weather", "prices", "uncertainty",
    "probe_days", "probing", "controller",
)  # fmt: skip


@click.command()
@base_options
@window_options
@click.option("--probe-days", type=float, help="Days of probing, ending a week before --period.  [default: 3]")
@probed_option
@click.option("--controller", metavar="NAME", help="Probe at the levels that this controller uses.")
@click.option("--data", "files", multiple=True, metavar="FILE", help="Measurements instead of probing; repeatable.")
@click.option("--map", "map_file", type=PATH, help="Map of the measurements (YAML).")
@click.option("--data-days", type=FiniteRange(1.0, 120.0), help="Days of longer measurements used.  [default: 28]")
@click.option("--out", type=PATH, default=Path("model"), help="Model folder.")
@click.option("--overwrite", is_flag=True, help="Replace an existing model.")
def identify(**options: Any) -> None:
    """Identify a thermal model, print it and save it as a model folder.

    A building that can be run is probed for a few days. The probing signal is designed for identifiability and keeps
    the zone near its comfort band. The probing days end where the warm-up of --period begins. If the model is then
    not competent (docs/how-it-works/competence.md), probing goes on day by day, up to identification.most_days (10).

    With --probing the model is identified from what an earlier run of the same test case has probed.

    With --data the model is identified from measurements in CSV or Parquet files, as --map says
    (docs/how-to/own-data.md); of long ones the 28 days that tell most about acting are used.

    A model that stays incompetent is saved, but the controllers do not act on it; the exit code is then 4, and the
    verdict says what to do. The folder also holds a plot of the fit and of the step response with its 90 % band.

    Use the model with `tf-mpc run --model FOLDER` or `tf-mpc plan --model FOLDER`.

    \b
    Example:
      tf-mpc identify --testcase bestest_hydronic_heat_pump --probe-days 3 --out my_model
      tf-mpc run --testcase bestest_hydronic_heat_pump --model my_model
      tf-mpc identify --data house.csv --map map.yaml --out my_house
    """
    from thermoforce_mpc.model.thermal_model import check_replaceable

    out: Path = options["out"]
    if out.exists() and not options["overwrite"]:
        raise ArtifactError(f"--out {out}: exists already; choose another folder or give --overwrite")
    check_replaceable(out, options["overwrite"])
    check_writable(out)
    if options["files"] or options["map_file"]:
        _from_measurements(options)
        return
    if options["data_days"] is not None:
        raise click.UsageError("--data-days belongs to --data")
    from thermoforce_mpc.experiment.experiment import Experiment
    from thermoforce_mpc.experiment.identifying import identification_task, run_identification
    from thermoforce_mpc.report.display import RunDisplay
    from thermoforce_mpc.scenario.scenario import Scenario
    from thermoforce_mpc.scenario.settings import merge, validate

    scenario = scenario_from(options)
    if options["probe_days"] is not None:
        changed = merge(scenario.model_dump(), {"identification": {"days": options["probe_days"]}})
        scenario = validate(Scenario, changed, "--probe-days")
    experiment = Experiment.of(scenario)
    task = identification_task(scenario, experiment.own.chosen)
    display = RunDisplay()
    records: list[Record] = []
    with closing(experiment.plant.build()) as plant:
        display.say(f"Plant: {plant.info.kind} {plant.info.testcase}\nWeather: {plant.info.weather}")
        with display.probing(task.in_words()) as progress:

            def probed(record: Record) -> None:
                records.append(record)
                progress.then("a model is identified")

            model = run_identification(task, plant, probed, progress, say=display.say)
    _finish(model, records[0], out, display, overwrite=options["overwrite"])


def _from_measurements(options: dict[str, Any]) -> None:
    files, map_file = options["files"], options["map_file"]
    if not files or map_file is None:
        raise click.UsageError("--data and --map belong together (see `tf-mpc data map FILE`)")
    others = [name for name in _OF_PLANTS if options.get(name)]
    if others:
        raise click.UsageError(f"--{others[0].replace('_', '-')} is for probing a plant: leave it out with --data")
    from thermoforce_mpc.experiment.identifying import may_act
    from thermoforce_mpc.experiment.measured_model import model_of_measurements
    from thermoforce_mpc.report.display import RunDisplay

    display, config = RunDisplay(), _options(options)
    days = options["data_days"]
    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        display.say(line)

    try:
        with display.phase("the measurements are read and a model is identified"):
            model, record = model_of_measurements(files, map_file, days=days, config=config, say=say)
    except DataError as error:
        if not said:  # the tables were not read: no probing mends that
            raise
        raise DataError(f"{error}\n{_PROBE}") from error
    if not may_act(model):
        display.say(_PROBE)
    _finish(model, record, options["out"], display, overwrite=options["overwrite"])


def _options(options: dict[str, Any]) -> IdentificationConfig:
    """Options of the identification in --seed and --set; of the latter only those make sense with measurements."""
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.scenario.settings import parse_overrides, validate

    overrides = parse_overrides(options.get("assignments", ()))
    chosen = overrides.get("identification", {}).get("options", {})
    if overrides and overrides != {"identification": {"options": chosen}}:
        raise click.UsageError("with --data, --set takes identification.options.KEY=VALUE only")
    seed = {} if options.get("seed") is None else {"seed": options["seed"]}
    return validate(IdentificationConfig, seed | chosen, "--set identification.options")


def _finish(model: ThermalModel, record: Record, out: Path, display: RunDisplay, *, overwrite: bool) -> None:
    """Save and show a model and the plot of its fit; exit code 4 where it is not competent."""
    from thermoforce_mpc.experiment.identifying import may_act
    from thermoforce_mpc.whatif.picture import PLOT_NAME, plot_identification

    model.save(out, overwrite=overwrite)
    show_model(str(out), model, display.console)
    plot_identification(out / PLOT_NAME, model, record)
    display.say(f"Plot of fit and step response: {out / PLOT_NAME}")
    if not may_act(model):
        click.get_current_context().exit(NOT_COMPETENT)


_LAGS_H = (1, 2, 4, 8, 12, 24, 48)
_CERTIFIED_H = 48
# Meaning of the scores of a model card, in printing order.
_MEANING = {
    "acts_log_odds": "log odds that the actuator acts on the zone at all",
    "held_out_linear": "held-out error with a constant gain, in standard deviations",
    "held_out_neural": "the same with a network as gain",
    "modulation_kept": "network kept (1) or not (0)",
    "sun_on_sensor": "probability that the sun shines on the zone sensor; it is taken off above 0.9",
    "aired_steps": "steps in which air came in, as through a window",
    "aired_K": "what it moved the room by in the mean, K",
}
_UNITS = {"T_zone_C": "zone, °C", "T_out_C": "outdoors, °C", "solar_W_m2": "sun, W/m²", "u": "action u"}


@click.command()
@click.argument("model", type=PATH)
def inspect(model: Path) -> None:
    """Show the saved MODEL (its folder, or a run's): parameters, certificate, power model, scores and data ranges.

    The certificate is recomputed from the weights; a model that fails it is refused with exit code 2.
    """
    from rich.console import Console

    from thermoforce_mpc.model.thermal_model import load_model

    console = Console(highlight=False, markup=False)
    for folder in _models_in(model):
        show_model(str(folder), load_model(folder), console)


def _models_in(folder: Path) -> list[Path]:
    """The folder of a model itself, or those of the models in a run's; raises `InputError` where a run has none."""
    from thermoforce_mpc.errors import InputError
    from thermoforce_mpc.model.saved import JSON_NAME

    if (folder / JSON_NAME).exists() or not (folder / "journal.jsonl").exists():
        return [folder]
    found = sorted(path.parent for path in folder.glob(f"model*/{JSON_NAME}"))
    if not found:
        raise InputError(f"{folder}: this run identified no model, or took one of --model; its controllers: kpis.csv")
    return found


def show_model(name: str, thermal: ThermalModel, console: Console) -> None:
    """Print parameters, certificate, power models, scores and data ranges of a model, actuator by actuator."""
    single = thermal.names.single
    if not single:
        _show_building(name, thermal, console)
    machines_shown: set[int] = set()
    notes_shown: set[str] = set()
    for a, actuator in enumerate(thermal.operator.actuators):
        zone = thermal.actuator(a)
        home = thermal.operator.zones[thermal.operator.home[a]]
        if not single:
            console.rule(f"{actuator} in {home}", align="left")
        _show_operator(name if single else actuator, zone.operator, zone.card, console)
        machine = thermal.machine_of[a]
        if machine not in machines_shown:  # shown with the first actuator that it feeds
            machines_shown.add(machine)
            _show_power("Power" if single else f"Power of {thermal.machines[machine]}", thermal.power[machine], console)
        _show_card(zone.card, console, notes_shown)
        notes_shown |= set(zone.card.notes)


def _show_building(name: str, thermal: ThermalModel, console: Console) -> None:
    operator = thermal.operator
    Z, A, _ = operator.shape
    pairs = list(operator.each())
    proofs = operator.certificates(n_steps=round(_CERTIFIED_H * 3600 / operator.step_s))
    wrong = [f"{actuator} on {zone}" for (zone, actuator), proof in proofs.items() if not proof.certified]
    console.print(
        f"{name}: zones: {Z}, actuators: {A}, machines: {len(thermal.machines)}; {len(pairs)} pairs with an effect, "
        f"{operator.n_trained} trained parameters, {operator.n_used} used, step {operator.step_s / 3600:g} h",
        soft_wrap=True,
    )
    for m, machine in enumerate(thermal.machines):
        fed = [operator.actuators[a] for a, other in enumerate(thermal.machine_of) if other == m]
        console.print(f"  {machine} feeds {', '.join(fed) or 'nothing'}", soft_wrap=True)
    certified = f"NOT CERTIFIED: {', '.join(wrong)}" if wrong else "every pair CERTIFIED"
    console.print(f"Certificate: {certified}", soft_wrap=True)
    from thermoforce_mpc.data import NORMAL_95
    from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H
    from thermoforce_mpc.whatif.step_response import step_response_of

    hours = STEP_RESPONSE_H[-1]
    table = plain_table(["zone", *operator.actuators])
    for z, zone in enumerate(operator.zones):
        cells = []
        for a in range(A):
            pair = operator.pairs[z][a]
            mean, sd = step_response_of(thermal, z, a)
            if pair is None:
                cells.append("no effect")
            elif mean.size:
                cells.append(
                    f"{mean[-1]:.2f} ({mean[-1] - NORMAL_95 * sd[-1]:.2f} to {mean[-1] + NORMAL_95 * sd[-1]:.2f})"
                )
            else:
                cells.append(f"{pair.impulse(round(hours * 3600 / pair.step_s)).sum():.2f}")
        table.add_row(zone, *cells)
    _titled(f"Change of each zone after {hours:g} h at full level, K (90 % band)", table, console)


def _show_operator(name: str, operator: OperatorParameters, card: ModelCard, console: Console) -> None:
    from thermoforce_mpc.model.operator.certificate import certificate

    proof = certificate(operator, n_steps=round(_CERTIFIED_H * 3600 / operator.step_s))
    say = console.print
    say(f"{name}: order {operator.order}, {operator.parameters_in_words}, step {operator.step_s / 3600:g} h")
    say(f"source: {card.source}")
    modes = plain_table(["mode", "time constant, h", "steady gain, K"])
    for i, (tau, gain) in enumerate(zip(operator.time_constants_h, operator.steady_gains_K, strict=True), start=1):
        modes.add_row(str(i), f"{tau:.2f}", f"{gain:.2f}")
    _titled("Modes of the forced response", modes, console)
    if operator.order > 1 and operator.steady_gains_K[0] * operator.sign < 0:
        say("  the first gain has the opposite sign: it represents the delay of the heat of the other modes")
    _show_step_response(card.uncertainty, operator.sign, console)
    low, high = proof.modulation_bounds
    say(
        f"Certificate: {'CERTIFIED' if proof.certified else 'NOT CERTIFIED'}; sign {proof.sign:+d}, "
        f"modulation within [{low:.3f}, {high:.3f}]"
    )
    if proof.feedback:
        least, most = proof.feedback_slope_per_K
        say(
            "  the modulation depends on the predicted temperature; proven for a feedback v dm/dT within "
            f"[{least:.4f}, {most:.4f}] per K, for the {len(proof.effect_low_K)} steps below"
        )
    effects = plain_table(["hours later", "at least", "at most"])
    for hours in _LAGS_H:
        k = round(hours * 3600 / operator.step_s) - 1
        if 0 <= k < len(proof.effect_low_K):
            effects.add_row(f"{hours:g}", f"{proof.effect_low_K[k]:.4f}", f"{proof.effect_high_K[k]:.4f}")
    title = f"Zone response to full actuation for one step of {operator.step_s / 3600:g} h, K (proven interval)"
    _titled(title, effects, console)
    if operator.heat_input.law is not None:
        c0, c1, c2, c3 = operator.heat_input.law.coefficients
        say(
            f"Heat: on x ({c0:.0f} {c1:+.1f} T_out) + u x ({c2:.0f} {c3:+.1f} T_out) W; full actuation above is "
            f"{operator.heat_input.reference_W:.0f} W, the heat at {operator.heat_input.reference_C:.1f} °C outdoors"
        )
    elif operator.heat_input.per_K:
        say(
            f"Heat of a level: {100 * operator.heat_input.per_K:+.1f} % per K outdoors; full actuation above is at "
            f"{operator.heat_input.reference_C:.1f} °C outdoors"
        )


def _show_power(what: str, power: PowerModel | None, console: Console) -> None:
    if power is None:
        return
    c0, c1, c2, c3 = power.coefficients
    water = power.water
    bend = f" + u^2 x {power.load.curve_W:.0f}" if power.load.curve_W else ""
    follows = f", the last part in water that follows u in {power.water_s / 3600:g} h" if power.water_s else ""
    times = f", times 1 {water.per_K:+.4f} (T_return - {water.reference_C:.1f})" if water else ""
    console.print(
        f"{what}: on x ({c0:.0f} {c1:+.1f} T_out) + u x ({c2:.0f} {c3:+.1f} T_out){bend} W{follows}{times}; "
        f"RMSE {power.rmse_W:.0f} W, R2 {power.r2:.4f}"
    )


def _show_card(card: ModelCard, console: Console, notes_shown: Set[str]) -> None:
    say = console.print
    if card.scores:
        say("Scores:")
    in_order = [key for key in _MEANING if key in card.scores]
    scores = Table.grid(padding=(0, 2))
    for key in [*in_order, *(key for key in card.scores if key not in _MEANING)]:
        scores.add_row(f"  {card.scores[key]:.3g}", _MEANING.get(key, key))
    say(scores)
    ranges = [
        f"{_UNITS.get(k, k)} {least:.4g} to {most:.4g}" for k, (least, most) in card.ranges.items() if k != "days"
    ]
    if ranges:
        days = card.ranges.get("days")
        say(f"Data ranges{f' in {days[1]:.3g} days' if days else ''}: " + "; ".join(ranges))
    for name, digest in card.data.items():
        say(f"  data {name}: sha256 {digest[:16]}")
    for note in _collapsed([note for note in card.notes if note not in notes_shown]):
        say(f"  note: {note}")
    if notes_shown & set(card.notes):
        say("  and the notes above that are of the same measurements")
    from thermoforce_mpc.model.machine.power import level_costs

    for cost in level_costs(card.uncertainty):
        heat = f"; heat per level {cost.heat:.2f} ± {cost.heat_sd:.2f} times that of full level"
        power = f"; so it takes {100 * cost.cost * cost.heat * cost.level:.0f} % of its full power"
        say(f"Tried: {cost}{heat}{power}", soft_wrap=True)
    _show_competence(card, console)


def _collapsed(notes: Sequence[str]) -> list[str]:
    """Notes that differ in their figures only (of pieces of a record between gaps) as one, with their number."""
    kinds: dict[str, list[str]] = {}
    for note in notes:
        kinds.setdefault(re.sub(r"\d+(\.\d+)?", "#", note), []).append(note)
    more = {key: f" (and {len(alike) - 1} more of its kind)" if len(alike) > 1 else "" for key, alike in kinds.items()}
    return [alike[0] + more[key] for key, alike in kinds.items()]


def _titled(title: str, table: Table, console: Console) -> None:
    """Print a table under its title, which may be longer than the table is wide."""
    console.print(title, style="italic")
    console.print(table)


def _show_competence(card: ModelCard, console: Console) -> None:
    verdict = card.competence
    if verdict is None:
        console.print("Competence: not judged" + (f". {card.unfit}" if card.unfit else ""), soft_wrap=True)
        return
    table = plain_table(["hours ahead", "model", "unchanged", "t", "weather alone", "t"])
    for score in verdict.horizons:
        unchanged = (f"{score.persistence_K:.2f}", f"{-score.persistence_t:.1f}")
        weather = (f"{score.weather_K:.2f}", f"{score.better_t:.1f}")
        table.add_row(f"{score.hours:g}", f"{score.model_K:.2f}", *unchanged, *weather)
    title = f"Errors on the {verdict.held_out_h:.0f} h held out, RMSE in K (weather known)"
    _titled(f"{title}; t: by how many standard errors the model's are smaller", table, console)
    console.print(
        f"Effect of 8 h at full level: {verdict.effect_K:+.1f} ± {verdict.effect_sd_K:.1f} K, of the expected sign "
        f"with probability {verdict.sign_probability:.3f}; log odds that it acts at all {verdict.log_odds:.0f}"
    )
    console.print(
        "Competence: " + ("COMPETENT" if verdict.competent else "NOT COMPETENT, controllers do not act on it")
    )
    console.print(f"  {verdict.sentence()}", soft_wrap=True)
    for reason in verdict.reasons:
        console.print(f"  missed: {reason}", soft_wrap=True)
    for advice in verdict.advice:
        console.print(f"  advice: {advice}", soft_wrap=True)


def _show_step_response(uncertainty: Mapping[str, float], sign: int, console: Console) -> None:
    lags_h = [h for h in _LAGS_H if f"step_response_{h}h_sd_K" in uncertainty]
    if not lags_h:
        return

    from thermoforce_mpc.data import NORMAL_95

    table = plain_table(["hours later", "expected", "from", "to"])
    for hours in lags_h:
        name = f"step_response_{hours}h"
        mean, sd = sign * uncertainty[f"{name}_K"], uncertainty[f"{name}_sd_K"]
        table.add_row(str(hours), f"{mean:.2f}", f"{mean - NORMAL_95 * sd:.2f}", f"{mean + NORMAL_95 * sd:.2f}")
    _titled("Step response of the zone to full actuation, K (90 % band)", table, console)
