"""The models of a run: identified for every contestant that needs one, said, and kept in the run folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from controllers.entries.entry import Chosen
from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.experiment.experiment import Contestant
from thermoforce_mpc.experiment.identifying import (
    IdentificationTask,
    IdentifiedModel,
    SavedModel,
    run_identification,
)
from thermoforce_mpc.files import file_sha256, plain_json
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.records.journal import Json
from thermoforce_mpc.records.recorded_plant import FOLDER as PROBING
from thermoforce_mpc.records.recorded_plant import JournaledPlant
from thermoforce_mpc.records.run_folder import file_stem, kept_model
from thermoforce_mpc.report.display import RunDisplay

if TYPE_CHECKING:  # loaded only when a controller needs a model
    from thermoforce_mpc.model.thermal_model import ThermalModel, ZoneModel
from thermoforce_mpc.protocols import Controller

FOLDER = "model"


def identify_all(
    contestants: Sequence[Contestant], plant: Plant, display: RunDisplay, folder: Path | None = None
) -> dict[str, IdentifiedModel]:
    """The model of every contestant that needs one; those whose models come from the same place share one.

    Each is probed for on its own account: what a controller does must not depend on whom it is compared with.
    `folder`: of the run, where the probings are kept.
    """
    models: dict[str, IdentifiedModel] = {}
    by_source: list[tuple[SavedModel | IdentificationTask, IdentifiedModel]] = []
    for one in contestants:
        if one.model_from is None:
            continue
        found = next((identified for other, identified in by_source if other == one.model_from), None)
        if found is None:
            if by_source:
                display.say(f"For {one.name}, which runs the machine another way:")
            keep = folder / PROBING / f"{file_stem(one.name)}.jsonl" if folder else None
            found = _identify(one.chosen, one.model_from, plant, display, keep)
            by_source.append((one.model_from, found))
        models[one.name] = found
    return models


def _identify(
    chosen: Chosen, source: SavedModel | IdentificationTask, plant: Plant, display: RunDisplay, keep: Path | None
) -> IdentifiedModel:
    """Load a model, or probe and identify one for the controller that was chosen, and say what came of it.

    Data that cannot be fitted do not end the run: without a model, the controller stands back. Raises `DataError` where
    it has its gate turned off.
    """
    try:
        if isinstance(source, SavedModel):
            model = source.load()
            display.say(f"Loaded {source.folder} ({model.cards[0].source})")
        else:
            with display.probing(source.in_words(keep)) as progress:
                model = run_identification(
                    source,
                    plant,
                    lambda _: progress.then("a model is identified"),
                    on_progress=progress,
                    keep=keep,
                    say=display.say,
                )
    except DataError as error:
        if not chosen.has_gate:
            raise
        display.say(f"No model could be identified: {error}")
        return IdentifiedModel(None, {"model": None, "refused": str(error)}, str(error))
    for a, name in enumerate(model.operator.actuators):
        zone, of = model.actuator(a), "" if model.names.single else f" of {name}"
        operator, verdict = zone.operator, zone.card.competence
        hours = ", ".join(f"{tau:.2g} h" for tau in operator.time_constants_h)
        found = f"Model{of}: order {operator.order} ({hours}), {operator.parameters_in_words}, "
        found += f"steady gain {operator.steady_gains_K.sum():.1f} K"
        display.say(found if verdict is None else f"{found}. {verdict.sentence()}")
        if verdict is None and zone.card.unfit:
            display.say(zone.card.unfit)
        elif verdict is not None and not verdict.competent:
            lines = [f"The model{of} is {verdict.in_words()}", *(f"  {advice}" for advice in verdict.advice)]
            display.say("\n".join(lines))
    doubted = [name for name, card in zip(model.operator.actuators, model.cards, strict=True) if card.unfit]
    if doubted and not chosen.has_gate:
        display.say(f"{', '.join(doubted)}: plans act all the same, since gate.enabled is false")
    model.say_claims(display.say)
    folder = source.folder if isinstance(source, SavedModel) else None
    return IdentifiedModel(model, {"model": folder, "source": model.cards[0].source} | origin(model))


def origin(model: ThermalModel) -> dict[str, Any]:
    """What the manifest says of a model; with several actuators, of each by its name."""
    origins = {name: _origin_of(model.actuator(a)) for a, name in enumerate(model.operator.actuators)}
    if model.names.single:
        return origins[model.operator.actuators[0]]
    counts = {"n_trained": model.operator.n_trained, "n_used": model.operator.n_used}
    return counts | {"pairs": len(list(model.operator.each())), "actuators": origins}


def _origin_of(zone: ZoneModel) -> dict[str, Any]:
    """What the manifest says of an actuator on its home zone."""
    operator, card = zone.operator, zone.card
    counts = {name: getattr(operator, name) for name in ("order", "n_trained", "n_used", "n_effective")}
    return counts | {
        "time_constants_h": operator.time_constants_h.tolist(),
        "steady_gains_K": operator.steady_gains_K.tolist(),
        "scores": dict(card.scores),
        "competence": None if card.competence is None else asdict(card.competence),
        "data_sha256": dict(card.data),
        "config": dict(card.config),
        "notes": list(card.notes),
    }


def kept_models(
    contestants: Sequence[Contestant], plant: JournaledPlant, display: RunDisplay, folder: Path
) -> dict[str, IdentifiedModel]:
    """The models of `identify_all`, saved in the run folder and noted in its journal; or those noted there.

    Either way they are read back from the folder, so that a resumed run uses the very same.

    Raises:
        ArtifactError: a model in the folder was changed since.
        StorageError: it cannot be written.
    """
    noted = plant.next_told("models")
    if noted is None:
        noted = plant.noted("models", _save_models(folder, identify_all(contestants, plant.inside, display, folder)))
    from thermoforce_mpc.model.saved import JSON_NAME
    from thermoforce_mpc.model.thermal_model import load_model

    loaded: dict[str, IdentifiedModel] = {}
    for key, entry in {str(entry): entry for entry in noted["models"].values()}.items():
        if entry["folder"] is None:
            loaded[key] = IdentifiedModel(None, entry["origin"], entry["refused"])
            continue
        path = kept_model(folder, entry["folder"])
        model = load_model(path)
        if file_sha256(path / JSON_NAME) != entry["sha256"]:
            raise ArtifactError(f"{path}: is not the model that this run began with; start the run again")
        loaded[key] = IdentifiedModel(model, entry["origin"])
    return {who: loaded[str(entry)] for who, entry in noted["models"].items()}


def _save_models(folder: Path, identified: Mapping[str, IdentifiedModel]) -> Json:
    """Save each different model once; what the journal says of them."""
    from thermoforce_mpc.model.saved import JSON_NAME

    noted: dict[int, Json] = {}
    for who, result in identified.items():
        if id(result) in noted:
            continue
        entry: Json = {"folder": None, "refused": result.refused, "origin": plain_json(result.origin)}
        if result.model is not None:
            entry["folder"] = f"{FOLDER}-{file_stem(who)}" if noted else FOLDER
            result.model.save(folder / entry["folder"], overwrite=True)
            entry["sha256"] = file_sha256(folder / entry["folder"] / JSON_NAME)
        noted[id(result)] = entry
    return {"models": {who: noted[id(result)] for who, result in identified.items()}}


def origins_of(identified: Mapping[str, IdentifiedModel], controller: str) -> dict[str, Any]:
    """Where the models came from: the controller's, and by name those of baselines that have one of their own."""
    if controller not in identified:
        return {}
    own_model = identified[controller]
    baselines = {name: dict(model.origin) for name, model in identified.items() if model is not own_model}
    return dict(own_model.origin) | ({"baselines": baselines} if baselines else {})


def weight_hash(controller: Controller) -> str | None:
    """Hash of the forecasters' weights, where the controller has any with weights; each different one once."""
    methods = getattr(getattr(controller, "predictor", None), "free_responses", ())
    different = {id(method): method for method in methods}.values()
    hashes = [method.weight_hash() for method in different if hasattr(method, "weight_hash")]
    return " ".join(dict.fromkeys(hashes)) or None


def frozen_proof(controller: Controller, before: str | None) -> dict[str, Any]:
    """What the manifest says of the weights after a run; empty where there are none. `before`: their hash before it."""
    if before is None:
        return {}
    after = weight_hash(controller)
    return {"weights_before": before, "weights_after": after, "frozen": before == after}
