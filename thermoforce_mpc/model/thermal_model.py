"""The thermal model of a building: what was identified on it, and what is saved."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.encoding import decode, encode
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.model_file import JSON_NAME, check_target, read_model_file, write_model_file
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.parameters import OperatorParameters


@dataclass(frozen=True)
class ThermalModel:
    """Everything identified on one building: operator, electric power, linear free model, and where it comes from."""

    operator: OperatorParameters
    power: PowerModel | None = None
    free: RcParameters | None = None
    card: ModelCard = field(default_factory=ModelCard)

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
