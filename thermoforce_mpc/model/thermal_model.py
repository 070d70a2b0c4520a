"""The thermal model of a building: what was identified on it, and what is saved."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from thermoforce_mpc.data import Array, Boundary, Observation, Record
from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.encoding import decode, encode
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.model_file import JSON_NAME, check_target, read_model_file, write_model_file
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import Prediction, Predictor
from thermoforce_mpc.protocols import FreeResponse


@dataclass(frozen=True)
class ThermalModel:
    """Everything identified on one building: operator, electric power, linear free model, and where it comes from."""

    operator: OperatorParameters
    power: PowerModel | None = None
    free: RcParameters | None = None
    card: ModelCard = field(default_factory=ModelCard)

    def predict(
        self, record: Record, weather: Boundary, u: Array | float, *, free_response: FreeResponse | None = None
    ) -> Prediction:
        """Temperature over the steps of `weather`, free and forced response apart, with its 80 % band.

        Args:
            record: what was measured until now, at any step; a week or more for the best free response.
            weather: boundary conditions from now on, N steps; only outdoor temperature and irradiance count.
            u: actuator levels in [0, 1], shape (N,) or (..., N) for several candidates, or one level for all steps.
            free_response: forecaster of the free response; by default the controllers' (`residual`).

        Raises:
            DataError: `u` has another shape or leaves [0, 1], the record cannot be split into free and forced
                response, or the weather has gaps.
        """
        method = free_response or build_free_response("residual", rc=self.free)
        levels = np.asarray(u, dtype=np.float64)
        if levels.ndim == 0:
            levels = np.full(weather.n_steps, levels)
        return Predictor(self.operator, method).context(Observation(record, weather)).predict(levels)

    def summary(self) -> str:
        """The model in a few lines: source, operator, effect of a day with its uncertainty, verdict, notes."""
        operator, uncertainty = self.operator, self.card.uncertainty
        hours = ", ".join(f"{tau:.2g} h" for tau in operator.time_constants_h)
        lines = [
            f"identified from {self.card.source}",
            f"operator of order {operator.order} ({hours}), {operator.parameters_in_words}",
        ]
        if "step_response_24h_K" in uncertainty:
            effect, sd = uncertainty["step_response_24h_K"], uncertainty["step_response_24h_sd_K"]
            lines.append(f"a day at full level changes the zone by {operator.sign * effect:+.1f} ± {sd:.1f} K")
        if self.power is None:
            lines.append("electric power was not measured: the model predicts, but energy cannot be planned")
        else:
            lines.append(f"electric power: RMSE {self.power.rmse_W:.0f} W, R² {self.power.r2:.3f}")
        verdict = self.card.competence
        lines.append("competence: not judged" if verdict is None else verdict.in_words())
        return "\n".join([*lines, *(f"note: {note}" for note in self.card.notes)])

    def save(self, folder: Path | str, *, overwrite: bool = False) -> Path:
        """Write the model to `folder`; the same model gives the same bytes.

        Raises:
            ArtifactError: `folder` exists (unless `overwrite` and it holds a model), the model fails its certificate,
                or the disk refuses.
        """
        folder = Path(folder)
        check_target(folder, overwrite=overwrite)
        proof = certificate(self.operator)
        if not proof.certified:
            raise ArtifactError(f"{folder}: not saved, the operator fails its certificate: {'; '.join(proof.reasons)}")
        content, arrays = encode(self.operator, self.power, self.free, self.card)
        write_model_file(folder, content | {"certificate": proof.to_json()}, arrays)
        return folder


def load_model(folder: Path | str) -> ThermalModel:
    """Read a saved model and prove its certificate again.

    Raises:
        ArtifactError: the folder or a file is missing, damaged, foreign or of another version, or the operator fails
            its certificate; the message names the file and the reason.
    """
    folder = Path(folder)
    content, arrays = read_model_file(folder)
    path = folder / JSON_NAME
    try:
        model = ThermalModel(*decode(content, arrays))
    except KeyError as error:
        raise ArtifactError(f"{path}: key {error} is missing; the file is damaged or was edited") from error
    except (DataError, TypeError, ValueError, AttributeError) as error:
        raise ArtifactError(f"{path}: {error}") from error
    proof = certificate(model.operator)
    if not proof.certified:
        raise ArtifactError(f"{path}: the operator fails its certificate: {'; '.join(proof.reasons)}")
    return model
