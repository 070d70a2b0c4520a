"""The thermal model of a building: what was identified on it, zone by zone, and what is saved."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, SINGLE, Array, Boundary, Layout, Names, Observation, Record
from thermoforce_mpc.data.limits import EFFECT_K
from thermoforce_mpc.data.names import check_same_building, numbers
from thermoforce_mpc.errors import ArtifactError, DataError, check_kind, check_path
from thermoforce_mpc.model.card import UNTOLD_SD, ModelCard
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.late_sensor import LateReadings, LateSensor
from thermoforce_mpc.model.machine.blocked_hours import BlockedHours, HourEffects, HourSeen, said
from thermoforce_mpc.model.machine.change import UNKNOWN, Share, share_of_change
from thermoforce_mpc.model.machine.other_load import own_W
from thermoforce_mpc.model.machine.power import PowerModel, fixed_part, level_costs
from thermoforce_mpc.model.operator.building import BuildingOperator, single
from thermoforce_mpc.model.operator.certificate import Certificate
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import Prediction, Predictor
from thermoforce_mpc.model.saved import FILES, JSON_NAME, decode, encode, read_model_file, write_model_file
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor, off_sensors
from thermoforce_mpc.protocols import FreeResponse

# What a card says of its arrays, and how exactly: it is worked out from them.
_STEP_RESPONSE = re.compile(r"step_response_(\d+)h_K(?:\[(.+)\])?")
_SAME, _EFFECT_H = 1e-3, 8.0
_PICTURES = (".png", ".svg")
_Found = TypeVar("_Found")


@dataclass(frozen=True)
class ZoneModel:
    """Operator of an actuator on its home zone, power of its machine, linear free model and card of the zone.

    `power` is None where it was not measured, `free` where the zone was identified from pairs alone.
    """

    operator: OperatorParameters
    power: PowerModel | None = None
    free: RcParameters | None = None
    card: ModelCard = field(default_factory=ModelCard)


@dataclass(frozen=True)
class ThermalModel:
    """Everything identified on one building of Z zones, A actuators and M machines.

    Attributes:
        operator: operators of all pairs of zone and actuator.
        power: electric power (or that of another carrier) of each machine (M,); None where it was not measured.
        free: linear free model of each zone (Z,); None where it was identified from pairs alone.
        cards: source and quality of each actuator's model on its home zone (A,).
        machines: names of the machines (M,).
        machine_of, shares, exclusive, floor_area_m2: as in `Layout`.

    Raises `DataError` for a part without as many entries as there are zones, actuators or machines.
    """

    operator: BuildingOperator
    power: tuple[PowerModel | None, ...]
    free: tuple[RcParameters | None, ...]
    cards: tuple[ModelCard, ...]
    machines: tuple[str, ...] = SINGLE.machines
    machine_of: tuple[int, ...] = (0,)
    shares: tuple[float, ...] = (0.0,)
    exclusive: tuple[tuple[int, ...], ...] = ()
    floor_area_m2: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        zones, actuators, _ = self.operator.shape
        object.__setattr__(self, "floor_area_m2", self.floor_area_m2 or (float("nan"),) * zones)
        for what, length, expected in (
            ("free", len(self.free), zones),
            ("cards", len(self.cards), actuators),
            ("power", len(self.power), len(self.machines)),
            ("machine_of", len(self.machine_of), actuators),
            ("shares", len(self.shares), actuators),
            ("floor_area_m2", len(self.floor_area_m2), zones),
        ):
            if length != expected:
                raise DataError(f"thermal model: {what} has {length} entries, expected {expected}")
        if not all(0 <= m < len(self.machines) for m in self.machine_of):
            raise DataError(f"thermal model: machine_of {self.machine_of}: there are {len(self.machines)} machines")
        if self.exclusive:
            _ = self.layout  # refuses groups that do not fit

    @classmethod
    def single(
        cls,
        operator: OperatorParameters,
        power: PowerModel | None = None,
        free: RcParameters | None = None,
        card: ModelCard | None = None,
    ) -> ThermalModel:
        """The model of one zone with one actuator."""
        return cls.of_zone(ZoneModel(operator, power, free, card or ModelCard()))

    @classmethod
    def of_zone(cls, zone: ZoneModel) -> ThermalModel:
        """The building of one zone with one actuator."""
        return cls(single(zone.operator), (zone.power,), (zone.free,), (zone.card,))

    @cached_property
    def names(self) -> Names:
        """Names of zones, actuators and machines."""
        return Names(self.operator.zones, self.operator.actuators, self.machines)

    @cached_property
    def layout(self) -> Layout:
        """What acts where."""
        heads = self.operator.of_actuators
        return Layout(
            self.names,
            tuple(head.sign for head in heads),
            self.operator.home,
            self.machine_of,
            tuple(head.heat_input.u_min for head in heads),
            self.shares,
            self.floor_area_m2,
            self.exclusive,
        )

    def with_actuators(self, zones: Sequence[ZoneModel]) -> ThermalModel:
        """The building with other operators of its actuators on their home zones (A,).

        What an actuator delivers changes for all zones; what a unit of it does to zones other than its home stays as
        identified.
        """

        def changed(z: int, a: int, pair: OperatorParameters | None) -> OperatorParameters | None:
            own = zones[a].operator
            if pair is None or self.operator.home[a] == z:
                return None if pair is None else own
            # Gains are per v, whose heat may be another: K per W stay.
            gains = pair.gains * (own.heat_input.reference_W / pair.heat_input.reference_W)
            return replace(own, poles=pair.poles, gains=gains)

        pairs = tuple(
            tuple(changed(z, a, pair) for a, pair in enumerate(row)) for z, row in enumerate(self.operator.pairs)
        )
        return replace(self, operator=replace(self.operator, pairs=pairs))

    def actuator(self, a: int) -> ZoneModel:
        """Actuator `a` on its home zone."""
        free = self.free[self.operator.home[a]]
        return ZoneModel(self.operator.of_actuator(a), self.power[self.machine_of[a]], free, self.cards[a])

    @property
    def only(self) -> ZoneModel:
        """The zone of a building that has one, with one actuator; raises `DataError` where there are several."""
        if not self.names.single:
            raise DataError(f"the model has {self.names}: name the zone and the actuator")
        return self.actuator(0)

    @cached_property
    def sun_on_sensors(self) -> tuple[SunOnSensor | None, ...]:
        """Sun on the sensor of each zone (Z,), as identified with the first actuator that found any."""
        return self._of_zones([card.sun_on_sensor for card in self.cards])

    @cached_property
    def late_sensors(self) -> tuple[LateSensor | None, ...]:
        """How late the sensor of each zone reads (Z,); None where it does not."""
        return self._of_zones([card.late_sensor for card in self.cards])

    def _of_zones(self, found: Sequence[_Found | None]) -> tuple[_Found | None, ...]:
        """What was found with the first actuator of each zone (Z,) that found any, from that with each one (A,)."""
        by_home = [(home, one) for home, one in zip(self.operator.home, found, strict=True) if one is not None]
        return tuple(next((one for home, one in by_home if home == z), None) for z in range(len(self.operator.zones)))

    def card_of(self, z: int, a: int) -> tuple[ModelCard, str]:
        """The card that says how well the effect of actuator `a` on zone `z` is known, and how names on it end.

        Effects between zones stand on the card of the zone's first actuator, by the other actuator's name.
        """
        home = self.operator.home
        if home[a] == z:
            return self.cards[a], ""
        return self.cards[home.index(z) if z in home else a], f"[{self.operator.actuators[a]}]"

    def relative_sd(self, z: int, a: int) -> float:
        """Relative standard deviation of what a day of actuator `a` does to zone `z`; NaN where no card says it."""
        card, ending = self.card_of(z, a)
        mean_K, sd_K = (card.uncertainty.get(f"step_response_24h{of}_K{ending}", np.nan) for of in ("", "_sd"))
        return float(sd_K / max(abs(mean_K), 1e-9))

    def counted_on(self, z: int, a: int) -> float:
        """The share of the effect of actuator `a` on zone `z` that is known: plans count on no heat that may not come.

        All of one on its home zone, and of one between zones whose relative standard deviation is at most `UNTOLD_SD`
        or not said; none at twice that.
        """
        sd = self.relative_sd(z, a)
        if self.operator.home[a] == z or not sd > UNTOLD_SD:
            return 1.0
        return max(2.0 - sd / UNTOLD_SD, 0.0)

    @property
    def claims(self) -> tuple[str, ...]:
        """What was found of sensors, windows, meters, machines, hours and neighbours that changes plans, in words."""
        names, told = self.names, list[str]()
        for of_sensors in (self.sun_on_sensors, self.late_sensors):
            for z, found in enumerate(of_sensors):
                if found is not None:
                    told.append(found.in_words() if len(names.zones) == 1 else f"{names.zones[z]}: {found.in_words()}")
        for z, air in enumerate(self._of_zones([card.air_in_words or None for card in self.cards])):
            if air is not None:
                told.append(air if len(names.zones) == 1 else f"{names.zones[z]}: {air}")
        for machine, power in zip(names.machines, self.power, strict=True):
            if power is not None and power.foreign is not None:
                told.append(f"power of {machine}: {power.foreign.in_words()}")
        for m, machine in enumerate(names.machines):
            told += [f"power of {machine}: {words}" for words in self._switched(m)]
        for a, card in enumerate(self.cards):
            if card.foreign_heat is not None:
                told.append(f"heat of {names.actuators[a]}: {card.foreign_heat.in_words()}")
            told += [names.of_actuator(a, hours) for hours in self._hours(a)]
        for z, zone in enumerate(names.zones):
            for a, actuator in enumerate(names.actuators):
                if self.operator.pairs[z][a] is not None and (share := self.counted_on(z, a)) < 1.0:
                    told.append(
                        f"{zone}: what {actuator} does to it is known to ± {100.0 * self.relative_sd(z, a):.0f} % "
                        f"only: plans count on {100.0 * share:.0f} % of it"
                    )
        return tuple(told)

    def say_claims(self, say: Callable[[str], None], told: str = "") -> None:
        """Say each of `claims` whose words, but for the name before them, are not `told` already."""
        for claim in self.claims:
            _, named, words = claim.partition(": ")
            if not told or (words if named else claim) not in told:
                say(f"Found: {claim}")

    def _switched(self, m: int) -> list[str]:
        """Why machine `m` is switched at full level, in words, where that is for a fixed part; else nothing."""
        power, fed = self.power[m], self.layout.fed_by(m)
        if power is None or any(self.layout.u_min[a] < 0.0 for a in fed):
            return []
        for a in fed:
            costs, law = level_costs(self.cards[a].uncertainty), self.operator.of_actuator(a).heat_input.law
            if found := fixed_part(power, law, costs, shared=len(fed) > 1):
                return [f"{found}: in mode auto it is switched at full level (controller.options.actuation.mode)"]
        return []

    def _hours(self, a: int) -> list[str]:
        """Hours of the day in which acting does less, in words."""
        card, operator = self.cards[a], self.operator.of_actuator(a)
        hours = [card.blocked_hours, *[card.blocked_cooling_hours] * (operator.heat_input.u_min < 0.0)]
        effects = HourEffects(operator.sign, tuple(HourSeen(*one) for one in card.hour_effects))
        blocked = said(tuple(BlockedHours.known(each, 0.0) for each in hours)) if any(hours) else ""
        return [text for text in (blocked, effects.in_words()) if text]

    def own_heat(self, record: Record) -> Record:
        """`record` with the heat of the actuators alone: without the foreign loads on their meters."""
        foreign = [card.foreign_heat for card in self.cards]
        if not any(foreign):
            return record
        own = own_W(record.heat_W, foreign, record, self.layout.signs)
        return replace(record, heat_W=np.where(self._other_heat(record), own, record.heat_W))

    def _other_heat(self, record: Record) -> NDArray[np.bool_]:
        """Whether there is another load on the heat meter of each actuator after each step (A, n)."""
        return np.stack(
            [
                np.zeros(record.n_steps, dtype=bool)
                if card.foreign_heat is None
                else card.foreign_heat.there(record.u[[a]], record.time_s[:-1], record.T_out_C[:-1], sign * heat_W)
                for a, (card, sign, heat_W) in enumerate(zip(self.cards, self.layout.signs, record.heat_W, strict=True))
            ]
        )

    def news_of_others(self, power: Record, heat: Record) -> str:
        """What the last step told of other loads on meters, in words, by records of `power` and of `heat` as read."""
        told: dict[str, str] = {}
        for m, (machine, one) in enumerate(zip(self.names.machines, self.power, strict=True)):
            if one is not None and one.foreign is not None:
                rows = power.u[self.layout.fed_by(m)], power.time_s[:-1], power.T_out_C[:-1], power.power_W[m]
                told[f"power of {machine}"] = one.foreign.news(one.foreign.there(*rows))
        for actuator, card, there in zip(self.names.actuators, self.cards, self._other_heat(heat), strict=True):
            if card.foreign_heat is not None:
                told[f"heat of {actuator}"] = card.foreign_heat.news(there)
        return "; ".join(f"{where}: {news}" for where, news in told.items() if news)

    def in_rooms(self, record: Record) -> Record:
        """`record` with the temperatures of the rooms and the heat of the actuators, as `own_heat`."""
        return self.late_readings(off_sensors(self.own_heat(record), self.sun_on_sensors)).in_time()

    def late_readings(self, record: Record) -> LateReadings:
        """What late sensors read of `record`; raises `DataError` where what its levels bring is not known."""
        return LateReadings.of(record, self.operator, self.late_sensors)

    def power_change(self, m: int, record: Record) -> Share:
        """How much of what the power law of machine `m` says of other levels was in `record`."""
        power, by_law_W = self.power[m], self.power_by_law_of(m, record)
        if power is None or not np.isfinite(by_law_W).any():
            return Share(1.0, UNKNOWN)
        measured_W = own_W(record.power_W[m : m + 1], [power.foreign], record)[0]
        return share_of_change(by_law_W, measured_W, record)

    def power_by_law_of(self, m: int, record: Record) -> Array:
        """`power_by_law` of the levels and temperatures of `record` (n,), W."""
        return self.power_by_law(m, record.u, record.T_out_C[:-1], record.T_return_C[m])

    def power_by_law(self, m: int, u: Array, T_out_C: Array, T_return_C: Array | float = np.nan) -> Array:
        """Power of machine `m` by levels `u` (A, n) at `T_out_C`, `T_return_C` (n,) °C, W, without other loads (n,).

        NaN where it has no law, or heats and cools and feeds several actuators.
        """
        power, layout = self.power[m], self.layout
        fed = list(layout.fed_by(m))
        if power is None or (len(fed) > 1 and power.cooling is not None):
            return np.full(T_out_C.shape, np.nan)
        u = np.clip(u[fed], np.array(layout.u_min)[fed, None], 1.0)
        if len(fed) == 1:
            return power(u[0], T_out_C, T_return_C)
        return power.of_actuators(u, np.array(layout.weights)[fed], T_out_C)

    def powers_by_law(self, u: Array, T_out_C: Array) -> Array:
        """`power_by_law` of each machine, (M, n)."""
        return np.array([self.power_by_law(m, u, T_out_C) for m in range(len(self.machines))])

    def predict(
        self,
        record: Record,
        weather: Boundary,
        u: Array | float,
        *,
        free_response: FreeResponse | Sequence[FreeResponse] | None = None,
    ) -> Prediction:
        """Temperatures over the steps of `weather`, free and forced response apart, with their 80 % band.

        Args:
            record: what was measured until now, at the step of `weather`; a week or more for the best free response.
            weather: boundary conditions from now on, N steps; only outdoor temperature and irradiance count.
            u: actuator levels in [0, 1], shape (A, N) or (..., A, N) for several candidates, (N,) for one actuator, or
                one level for all steps of all actuators.
            free_response: forecaster of the free response, one per zone or one for all; by default the controllers'
                (`residual`).

        Raises:
            DataError: `u` has another shape or leaves [0, 1], the record is of another building or cannot be split into
                free and forced response, or the weather has gaps or does not begin where the record ends.
        """
        check_kind(record, Record, "record")
        check_same_building("the model", self.names, "the record", record.names, single_alike=True)
        for one in free_response if isinstance(free_response, Sequence) else filter(None, [free_response]):
            check_kind(one, FreeResponse, "free_response", "build_free_response(name) gives one")
        methods = free_response or [build_free_response("residual", rc=free) for free in self.free]
        levels = numbers(u, "levels (u)")
        if levels.ndim == 0:
            levels = np.full((len(self.operator.actuators), weather.n_steps), levels)
        return Predictor(self.operator, methods).context(Observation(self.in_rooms(record), weather)).predict(levels)

    def summary(self) -> str:
        """The model in a few lines: source, operator, effect of a day with its uncertainty, verdict, notes."""
        lines = [f"identified from {self.cards[0].source}"]
        for a, name in enumerate(self.operator.actuators):
            lines += self._actuator_lines(a, "" if self.names.single else f"{name}: ")
        if not self.names.single:
            pairs = len(list(self.operator.each()))
            counts = f"{self.operator.n_trained} trained parameters in all, {self.operator.n_used} used"
            lines.append(f"{pairs} pairs with an effect, {counts}")
        for m, power in enumerate(self.power):
            prefix = "" if len(self.power) == 1 else f"{self.machines[m]}: "
            if power is None:
                lines.append(
                    f"{prefix}electric power was not measured: the model predicts, but energy cannot be planned"
                )
            else:
                lines.append(f"{prefix}electric power: RMSE {power.rmse_W:.0f} W, R² {power.r2:.3f}")
        for a, card in enumerate(self.cards):
            prefix = "" if len(self.cards) == 1 else f"{self.operator.actuators[a]}: "
            verdict = card.competence
            lines.append(prefix + ("competence: not judged" if verdict is None else verdict.in_words()))
            lines += [f"{prefix}note: {note}" for note in card.notes]
        return "\n".join(lines)

    def _actuator_lines(self, a: int, prefix: str) -> list[str]:
        zone = self.actuator(a)
        operator, uncertainty = zone.operator, zone.card.uncertainty
        hours = ", ".join(f"{tau:.2g} h" for tau in operator.time_constants_h)
        lines = [f"{prefix}operator of order {operator.order} ({hours}), {operator.parameters_in_words}"]
        if "step_response_24h_K" in uncertainty:
            effect, sd = uncertainty["step_response_24h_K"], uncertainty["step_response_24h_sd_K"]
            lines.append(f"{prefix}a day at full level changes the zone by {operator.sign * effect:+.1f} ± {sd:.1f} K")
        return lines

    def implausible(self, a: int) -> str:
        """Why what actuator `a` does to its zone cannot be (`data.limits.EFFECT_K`), or ''."""
        effect_K = _step_response_K(self.operator.of_actuator(a), _EFFECT_H)
        if abs(effect_K) <= EFFECT_K:
            return ""
        return f"{_EFFECT_H:g} h at full level change the zone by {effect_K:.4g} K, at most {EFFECT_K:g} are plausible"

    def save(self, folder: Path | str, *, overwrite: bool = False) -> Path:
        """Write the model to `folder`; the same model gives the same bytes.

        Raises `ArtifactError` as `check_replaceable` or where the model fails its certificate, and `StorageError` where
        the disk refuses.
        """
        check_path(folder, "save: folder")
        folder = Path(folder)
        check_replaceable(folder, overwrite)
        proofs = self.operator.certificates()
        _check_proofs(proofs, f"{folder}: not saved, ")
        content, arrays = encode(**{item.name: getattr(self, item.name) for item in fields(self)})
        certificates = [
            {"zone": zone, "actuator": actuator, **proof.to_json()} for (zone, actuator), proof in proofs.items()
        ]
        write_model_file(folder, content | {"certificates": certificates}, arrays)
        return folder


def load_model(folder: Path | str) -> ThermalModel:
    """Read a saved model; what its card says of its arrays, and its certificate, are worked out again.

    Raises `ArtifactError` naming the file and the reason, `DataError` for what is no path.
    """
    check_path(folder, "load_model: folder", "give the folder that `tf-mpc identify` or model.save wrote")
    folder = Path(folder)
    content, arrays = read_model_file(folder)
    return model_from(content, arrays, folder / JSON_NAME)


def model_from(content: Mapping[str, Any], arrays: Mapping[str, Array], path: Path) -> ThermalModel:
    """The model that the file `path` holds as `content` and `arrays`; raises `ArtifactError`, as `load_model`."""
    try:
        model = ThermalModel(**decode(content, arrays))
    except KeyError as error:
        raise ArtifactError(f"{path}: key {error} is missing; the file is damaged or was edited") from error
    except (DataError, TypeError, ValueError, AttributeError) as error:
        raise ArtifactError(f"{path}: {error!s:.500}") from error
    _check_proofs(model.operator.certificates(), f"{path}: ")
    for a in range(len(model.cards)):
        if why := _disbelieved(model, a):
            of = "" if len(model.cards) == 1 else f" of {model.operator.actuators[a]}"
            raise ArtifactError(f"{path}: the model{of} is not what its card says: {why}; identify again")
    return model


def _disbelieved(model: ThermalModel, a: int) -> str:
    """Why the card of actuator `a` cannot be that of the model's arrays, or the arrays those of a building; or ''."""
    operator, card, z = model.operator, model.cards[a], model.operator.home[a]
    verdict, own = card.competence, operator.of_actuator(a)
    if too_much := model.implausible(a):
        return too_much
    for name, said_K in card.uncertainty.items():
        found = _STEP_RESPONSE.fullmatch(name)
        other = operator.actuators.index(found[2]) if found and found[2] in operator.actuators else a
        pair = operator.pairs[z][other] if found else None
        if found is None or pair is None or (found[2] and other == a):
            continue
        response_K = _step_response_K(pair, float(found[1])) * (own.sign if other == a else 1)
        if not math.isclose(said_K, response_K, rel_tol=_SAME, abs_tol=_SAME):
            return f"{name} is {said_K:.4g}, by its arrays {response_K:.4g}"
    if verdict is None:
        return ""
    said_K = own.sign * card.uncertainty.get(f"step_response_{_EFFECT_H:g}h_K", math.nan)
    if math.isfinite(said_K) and not math.isclose(verdict.effect_K, said_K, rel_tol=_SAME, abs_tol=_SAME):
        return f"its verdict is on an effect of {verdict.effect_K:.4g} K, by its arrays it is {said_K:.4g} K"
    why = verdict.contradiction(by_loops=own.heat_input.u_min < 0.0)
    return f"it is called competent, but {why}" if why else ""


def _step_response_K(pair: OperatorParameters, hours: float) -> float:
    """Change by `hours` at full level where the gain is 1, K."""
    steps = max(1, int(hours * HOUR_S // pair.step_s))
    return float(pair.impulse(steps).sum())


def check_replaceable(folder: Path, overwrite: bool) -> None:
    """Raise `ArtifactError` where a model cannot be saved in `folder`, which is replaced.

    It exists, unless with `overwrite` it is that of a model, and holds nothing else that would be removed.
    """
    if not folder.exists():
        return
    if not overwrite:
        raise ArtifactError(f"{folder}: exists already; choose another folder or ask to overwrite it")
    if not (folder / JSON_NAME).is_file():
        raise ArtifactError(f"{folder}: not overwritten, since it holds no {JSON_NAME} and so is not a saved model")
    # Pictures are drawn again.
    others = [p.name for p in sorted(folder.iterdir()) if p.name not in FILES and p.suffix not in _PICTURES]
    if others:
        raise ArtifactError(
            f"{folder}: not overwritten, since {others[0]} in it would be removed; choose another folder"
        )


def _check_proofs(proofs: Mapping[tuple[str, str], Certificate], where: str) -> None:
    for (zone, actuator), proof in proofs.items():
        if not proof.certified:
            of_pair = "" if len(proofs) == 1 else f" of {actuator} on {zone}"
            raise ArtifactError(f"{where}the operator{of_pair} fails its certificate: {'; '.join(proof.reasons)}")
