"""The watch inside an MPC: what it is given before and after each plan, and predictions in the shadow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from controllers.errors import said
from controllers.planner import MPCState, Planner
from controllers.watch import Track, Watch, WatchState
from thermoforce_mpc.data import HOUR_S, Observation, Plan, Record
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.thermal_model import ThermalModel


class WatchedPredictions:
    """Moves what the watch needs in and out of the state of an MPC; it holds no state.

    Args:
        watch: judges the predictions.
        planner: the planner of a thermal model.
    """

    def __init__(self, watch: Watch, planner: Callable[[ThermalModel], Planner]) -> None:
        self._watch, self._planner = watch, planner

    def judged(self, now: MPCState, history: Record) -> MPCState:
        """The state with the predictions that came due judged; where control returns, with the model that held."""
        try:
            watch = self._watch.judged(now.watch, history, now.adaptation, now.predictor)
        except Exception as error:  # what watches must not stop what it watches
            return replace(now, watch=replace(now.watch, news=f"predictions could not be judged ({said(error)})"))
        if now.watch.alarm and not watch.alarm:
            now = replace(now, adaptation=watch.tracks[0].adaptation, predictor=watch.tracks[0].predictor)
        return replace(now, watch=watch)

    def put_down(self, now: MPCState, context: PredictionContext, operator: OperatorParameters) -> MPCState:
        """The state with the prediction of a plan put down, where one is due."""
        if not self._watch.due(float(context.boundary.time_s[0])):
            return now
        issued = self._watch.issued(now.watch.tracks[0], context, operator)
        return replace(now, watch=replace(now.watch, tracks=(issued,)))

    def shadowed(self, observation: Observation, now: MPCState) -> MPCState:
        """The state with new predictions of the models that are judged while another controller acts.

        `observation` has the boundary forecast of the horizon.
        """
        if not self._watch.due(observation.time_s):
            return now

        def predicted(track: Track) -> Track:
            assert track.adaptation is not None
            planner = self._planner(track.adaptation.model)
            try:
                context = planner.predictor.context(observation, track.predictor)
            except Exception:  # as in planning; without predictions a model does not get control back
                return track
            return replace(self._watch.issued(track, context, planner.operator), predictor=context.state)

        return replace(now, watch=replace(now.watch, tracks=tuple(map(predicted, now.watch.tracks))))

    def asked(self, observation: Observation, plan: Plan) -> Plan:
        """The plan, its state with the level asked for."""
        assert isinstance(plan.state, MPCState)
        if not self._watch.config.enabled:
            return plan
        # What room set-points ask for is a temperature; its level is expected, not asked.
        levels = [
            float("nan") if block.u is None or block.band_C else block.u * block.duration_s for block in plan.blocks
        ]
        watch = self._watch.asked(plan.state.watch, observation.time_s, sum(levels) / self._watch.step_s)
        news = f"watch: {watch.news}; " if watch.news else ""
        return replace(plan, why=news + plan.why, state=replace(plan.state, watch=watch))

    def reason(self, state: WatchState, time_s: float) -> str:
        """Why control was handed back, and when."""
        return f"watch: {state.alarm} (found {(time_s - state.since_s) / HOUR_S:.1f} h ago)"

    def doubtful(self, state: WatchState) -> bool:
        """See `Watch.doubtful`."""
        return self._watch.doubtful(state)
