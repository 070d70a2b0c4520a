"""All methods on one home: fit on the budget, choose on the validation part, score the test part once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.factual import baselines, operators
from benchmarks.factual.baselines import persistence, rmse_K, truth_of
from benchmarks.factual.homes import Prepared
from benchmarks.factual.operators import Forced
from benchmarks.factual.protocol import Protocol
from benchmarks.free_response.scales import backbone_of
from benchmarks.parameter_count import parameter_count
from thermoforce_mpc.data import HOUR_S, Array, Boundary
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse

PERSISTENCE, RAW = "persistence", "TSFM raw (zero-shot)"
RC_FULL, RC_PERSISTED = "RC full (weather oracle)", "RC persist-weather"
COVARIATES, COVARIATES_AR = "TSFM + covariates (ridge)", "TSFM + covariates + AR"
OURS, RESIDUAL = "ThermoForce", "ThermoForce, residual free response"
RESIDUAL_PERSISTED, BEST = "ThermoForce, residual, persist-weather", "ThermoForce, chosen on validation"
METHODS = (
    PERSISTENCE, RAW, RC_FULL, RC_PERSISTED, COVARIATES, COVARIATES_AR, OURS, RESIDUAL, RESIDUAL_PERSISTED, BEST,
)  # fmt: skip
_LEVELS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])


@dataclass
class Scores:
    """Test errors of one home, K: `errors[method][days][horizon]`; days 0 for methods without a budget."""

    home: str
    group: str
    errors: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    notes: dict[str, dict[str, str]] = field(default_factory=dict)
    backbones: dict[str, dict[str, float]] = field(default_factory=dict)
    window: dict[str, Any] = field(default_factory=dict)
    about: dict[str, Any] = field(default_factory=dict)


class Evaluation:
    """The methods on one home; forecasts that several budgets share are made once."""

    def __init__(self, home: Prepared, protocol: Protocol, backbone: str, others: Sequence[str] = ()) -> None:
        self.home, self.protocol, self.others = home, protocol, tuple(others)
        self.raw_model = ChronosFreeResponse(backbone_of(backbone), protocol.context_steps, resolutions="one")
        self.residual = ChronosFreeResponse("shipped_weather", protocol.context_steps, after_linear_weather=True)
        self.horizon = home.steps(max(protocol.horizons_h))
        self.validation = home.origins(home.validation, self.horizon)
        self.test = home.origins(home.test, self.horizon)
        self._composed: dict[tuple[str, str], Array] = {}

    def run(self) -> Scores:
        """Score every method at every budget."""
        began = time.perf_counter()
        home, protocol = self.home, self.protocol
        scores = Scores(home.home.name, home.home.group)
        raw = {part: self._composed_C(operators.without_operator(home, ""), part) for part in ("validation", "test")}
        self._score(scores, PERSISTENCE, 0, persistence(home, self.test, self.horizon), "")
        self._score(scores, RAW, 0, raw["test"], self.raw_model.label)
        for days in protocol.days:
            self._grey_boxes(scores, days)
            for name, autoregressive in ((COVARIATES, False), (COVARIATES_AR, True)):
                fit = baselines.covariate_fit(
                    home, self.raw_model, days, protocol.context_steps, raw["validation"], autoregressive=autoregressive
                )
                answer = raw["test"] if fit is None else baselines.corrected(home, fit, raw["test"], self.test)
                self._score(scores, name, days, answer, fit.note if fit else "raw: the budget holds too few forecasts")
            forced = self._ours(scores, days)
            if days == protocol.main_days:
                scores.window = self._window(forced, raw["test"])
                scores.backbones = self._backbones(forced)
        scores.about = self._about(time.perf_counter() - began)
        return scores

    def _grey_boxes(self, scores: Scores, days: int) -> None:
        fits = baselines.grey_boxes(self.home, days, self.horizon)
        if not fits:
            return
        checked = [
            self._error(baselines.simulate(self.home, f, self.validation, self.horizon, persisted=False), "validation")
            for f in fits
        ]
        fit = fits[int(np.argmin(checked))]
        for name, persisted in ((RC_FULL, False), (RC_PERSISTED, True)):
            answer = baselines.simulate(self.home, fit, self.test, self.horizon, persisted=persisted)
            self._score(scores, name, days, answer, fit.note)

    def _ours(self, scores: Scores, days: int) -> Forced:
        """ThermoForce at one budget; returns the forced part that the validation part chose."""
        found, refused = operators.candidates(self.home, days)
        none = operators.without_operator(self.home, "no operator: " + ("; ".join(refused) or "none lowers the error"))
        plain = self._validation_errors(none)
        ratios = [float(np.mean(self._validation_errors(f) / plain)) for f in found]
        forced = found[int(np.argmin(ratios))] if ratios and min(ratios) <= 1.0 - self.protocol.guard else none
        composed = self._composed_C(forced, "test")
        residual = self._residual_C(forced, "test")
        self._score(scores, OURS, days, composed, forced.note)
        self._score(scores, RESIDUAL, days, residual, forced.note)
        if days == self.protocol.main_days:
            held = self._residual_C(forced, "test", persisted=True)
            self._score(scores, RESIDUAL_PERSISTED, days, held, forced.note)
        # One choice per horizon, by the validation part.
        variants = {
            OURS: self._composed_C(forced, "validation"),
            RESIDUAL: self._residual_C(forced, "validation"),
        }
        answers = {OURS: composed, RESIDUAL: residual}
        entry, notes = scores.errors.setdefault(BEST, {}).setdefault(str(days), {}), []
        for hours in self.protocol.horizons_h:
            steps = self.home.steps(hours)
            checked = {name: self._error(answer, "validation", steps) for name, answer in variants.items()}
            name = min(checked, key=lambda key: checked[key])
            entry[f"{hours:g}"] = self._error(answers[name], "test", steps)
            notes.append(f"{hours:g} h: {name.removeprefix('ThermoForce, ')}")
        scores.notes.setdefault(BEST, {})[str(days)] = "; ".join(notes)
        return forced

    def _validation_errors(self, forced: Forced) -> Array:
        """Validation error of the composed forecast over each horizon, K."""
        answer = self._composed_C(forced, "validation")
        return np.array([self._error(answer, "validation", self.home.steps(h)) for h in self.protocol.horizons_h])

    def _composed_C(self, forced: Forced, part: str) -> Array:
        """Forecast of T − F by the frozen model plus F (paper eq:compose), (origins, N), °C."""
        key = (forced.note if forced.operator else "", part)
        if key not in self._composed:
            free = baselines.forecasts(
                self.home, self.raw_model, self._free(forced), self._origins(part), self.horizon,
                self.protocol.context_steps,
            )  # fmt: skip
            self._composed[key] = free + self._forced_ahead(forced, part)
        return self._composed[key]

    def _residual_C(self, forced: Forced, part: str, *, persisted: bool = False) -> Array:
        """Forecast of the residual free response, from all that is known at each origin, plus F, (origins, N), °C."""
        free, tasks = self._free(forced), []
        for o in self._origins(part):
            ahead = Boundary.measured(self.home.record.slice(o, o + self.horizon))
            if persisted:
                now = np.ones(ahead.time_s.size)
                ahead = replace(ahead, T_out_C=ahead.T_out_C[0] * now, solar_W_m2=ahead.solar_W_m2[0] * now)
            tasks.append((free[: o + 1], self.home.record.slice(0, o), ahead))
        medians = np.array([found.median_C for found in self.residual.forecast_many(tasks)])
        return medians + self._forced_ahead(forced, part)

    def _free(self, forced: Forced) -> Array:
        return np.asarray(self.home.record.T_zone_C[0] - forced.forced_K)

    def _forced_ahead(self, forced: Forced, part: str) -> Array:
        return np.array([forced.forced_K[o + 1 : o + self.horizon + 1] for o in self._origins(part)])

    def _origins(self, part: str) -> list[int]:
        return self.validation if part == "validation" else self.test

    def _error(self, answer: Array, part: str, steps: int | None = None) -> float:
        truth = truth_of(self.home, self._origins(part), self.horizon)
        return rmse_K((answer - truth)[:, :steps])

    def _score(self, scores: Scores, method: str, days: int, answer: Array, note: str) -> None:
        entry = scores.errors.setdefault(method, {}).setdefault(str(days), {})
        for hours in self.protocol.horizons_h:
            entry[f"{hours:g}"] = self._error(answer, "test", self.home.steps(hours))
        scores.notes.setdefault(method, {})[str(days)] = note

    def _backbones(self, forced: Forced) -> dict[str, dict[str, float]]:
        """Test error of the first horizon of every other backbone, raw and composed with the same operator."""
        found: dict[str, dict[str, float]] = {}
        first = self.home.steps(min(self.protocol.horizons_h))
        for name in self.others:
            model = ChronosFreeResponse(backbone_of(name), self.protocol.context_steps, resolutions="one")
            row = {"parameters": float(parameter_count(model.model))}
            for label, series, ahead in (
                ("raw", self.home.record.T_zone_C[0], 0.0),
                ("ours", self._free(forced), self._forced_ahead(forced, "test")),
            ):
                free = baselines.forecasts(
                    self.home, model, series, self.test, self.horizon, self.protocol.context_steps
                )
                row[label] = self._error(free + ahead, "test", first)
            found[name] = row
        return found

    def _window(self, forced: Forced, raw: Array) -> dict[str, Any]:
        """One test window for the figures: the one in which the forced part changes most."""
        ahead = self._forced_ahead(forced, "test")
        pick = int(np.argmax(np.ptp(ahead, axis=1)))
        origin = self.test[pick]
        past = slice(max(0, origin - self.home.steps_per_day), origin + 1)
        course = slice(past.start, origin + self.horizon + 1)
        window: dict[str, Any] = {
            "hours": ((np.arange(course.start, course.stop) - origin) * self.home.record.step_s / HOUR_S).tolist(),
            "measured_C": self.home.truth_C[course].tolist(),
            "free_C": self._free(forced)[course].tolist(),
            "raw_C": raw[pick].tolist(),
            "ours_C": self._composed_C(forced, "test")[pick].tolist(),
            "operator": forced.note if forced.operator else "",
            "gain_K": float(np.abs(forced.operator.steady_gains_K).sum()) if forced.operator else 0.0,
        }
        if forced.operator:
            level = self.home.levels[forced.meter][past.start : origin + self.horizon]
            window["level"] = level.tolist()
            fan = operators.at_levels(self.home, forced, self.raw_model, origin, _LEVELS, self.horizon)
            window |= {"levels": _LEVELS.tolist(), "fan_C": fan.tolist()}
        return window

    def _about(self, seconds: float) -> dict[str, Any]:
        """What was scored, for the manifest."""
        stamps = self.home.record.stamps()
        parts = {
            name: f"{stamps[a]} to {stamps[b]}"
            for name, (a, b) in (("fit", self.home.fit), ("validation", self.home.validation), ("test", self.home.test))
        }
        return {
            **parts,
            "fit_days": (self.home.fit[1] - self.home.fit[0]) / self.home.steps_per_day,
            "origins": {"validation": len(self.validation), "test": len(self.test)},
            "meters": list(self.home.levels),
            "notes": list(self.home.notes),
            "seconds": seconds,
        }
