"""Effects between zones: found where they are, shrunk where they are not, and said where the data are silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, random_levels, record

from thermoforce_mpc.data import HOUR_S, Layout, Names, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import assembled
from thermoforce_mpc.identification.estimation.regression import Effect
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.free_response.linear_weather import Persistence
from thermoforce_mpc.model.operator.parameters import ZONE, linear_operator
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ZoneModel, load_model

pytestmark = pytest.mark.slow

STEP_S = 1800.0
LINEAR = IdentificationConfig(modulation="linear", sun_on_sensor=False)
NAMES = Names(("living", "bed"), ("floor", "radiator"), ("pump", "boiler"))
LAYOUT = Layout(
    NAMES,
    signs=(1, 1),
    home=(0, 1),
    machine_of=(0, 1),
    u_min=(0.0, 0.0),
    shares=(0.0, 0.0),
    floor_area_m2=(100.0, 100.0),
)
# What a neighbour's heat does: the house's own response, a third of it.
NEIGHBOUR = House(gain_K=(0.6, 8.0))
FULL_W = sum(House().machine_W)


def two_rooms(coupled: bool, days: float = 3.0, same: bool = False) -> Record:
    """Living room and bedroom with a heater each; the living room's heater warms the bedroom too where `coupled`."""
    house, n = House(), round(days * 24 * HOUR_S / STEP_S)
    levels = [random_levels(n, seed, hold=8) for seed in (3, 3 if same else 4)]
    rooms = [record(house, days, STEP_S, seed=5, u=u, noise_K=0.01) for u in levels]
    bed_C = rooms[1].T_zone_C[0]
    if coupled:
        bed_C = bed_C + NEIGHBOUR.effect_K(rooms[0].heat_W[0] / FULL_W, STEP_S)
    return Record(
        rooms[0].time_s,
        np.stack([rooms[0].T_zone_C[0], bed_C]),
        rooms[0].T_out_C,
        rooms[0].solar_W_m2,
        np.stack(levels),
        np.stack([room.power_W[0] for room in rooms]),
        np.stack([room.heat_W[0] for room in rooms]),
        names=NAMES,
    )


@pytest.fixture(scope="module")
def coupled():
    return identify([two_rooms(coupled=True)], config=LINEAR, layout=LAYOUT)


def test_every_zone_keeps_its_order_and_area():
    zones = [
        ZoneModel(linear_operator(poles, [0.1] * len(poles), step_s=HOUR_S), None, None, ModelCard())
        for poles in ([0.9], [0.3, 0.98])
    ]
    layout = replace(LAYOUT, floor_area_m2=(100.0, 60.0))
    building = assembled(layout, zones, [[], []], [None, None], IdentificationConfig(), [0.0, 0.0], [np.nan, np.nan])
    assert building.floor_area_m2 == (100.0, 60.0)
    assert [pair.order for *_, pair in building.operator.each()] == [1, 2]
    assert building.operator.shape == (2, 2, 2)


def effect_K(pair, hours: float = 8.0) -> float:
    """Effect of `hours` of the machine's full heat at 0 °C."""
    steps = round(hours * HOUR_S / pair.step_s)
    return float(np.cumsum(pair.impulse(steps))[-1]) * FULL_W / pair.heat_input.reference_W


def test_a_neighbours_heat_is_found_where_it_is(coupled):
    true_K = NEIGHBOUR.effect_K(np.ones(16), STEP_S)[-1]
    own = coupled.operator.pairs[1][1]
    across = coupled.operator.pairs[1][0]
    assert across is not None
    assert effect_K(across) == pytest.approx(true_K, rel=0.35)
    assert effect_K(own) == pytest.approx(House().effect_K(np.ones(16), STEP_S)[-1], rel=0.2)
    assert all(proof.certified for proof in coupled.operator.certificates().values())


def test_the_network_is_trained_on_what_it_is_given_in_predictions():
    """T without what *all* actuators do: of the bedroom, also without the living room's heat."""
    record_, config = two_rooms(coupled=True), LINEAR.model_copy(update={"modulation": "always", "epochs": 5})
    model = identify([record_], config=config, layout=LAYOUT)
    predictor = Predictor(model.operator, Persistence())
    across_K = predictor.forced_history(record_)[1, 0].sum(axis=-1).mean()
    assert across_K > 1.0
    for a, free_C in enumerate(predictor.free_history(record_)):
        trained_C = model.operator.of_actuator(a).feature_mean[ZONE]
        assert trained_C == pytest.approx(free_C[:-1].mean(), abs=0.1 * across_K)


def test_no_effect_is_found_where_there_is_none():
    """Two rooms without a wall between them."""
    pairs = identify([two_rooms(coupled=False)], config=LINEAR, layout=LAYOUT).operator.pairs
    for zone, other in ((0, 1), (1, 0)):
        assert pairs[zone][other] is None or effect_K(pairs[zone][other]) < 0.05 * effect_K(pairs[zone][zone])


def test_a_valve_without_effect_does_not_refuse_the_rest():
    r = two_rooms(coupled=False)
    rng = np.random.default_rng(1)
    T = r.T_zone_C.copy()
    T[1] = 20.0 + 0.02 * np.cumsum(rng.standard_normal(T.shape[1]))  # the sensor hangs elsewhere
    model = identify([replace(r, T_zone_C=T)], config=LINEAR, layout=LAYOUT)
    first, second = (card.competence for card in model.cards)
    assert first.competent
    assert not second.competent
    assert "no effect of the actuator" in second.reasons[0]


def test_cross_effects_can_be_left_out():
    apart = LINEAR.model_copy(update={"cross_effects": False})
    model = identify([two_rooms(coupled=True)], config=apart, layout=LAYOUT)
    assert [[pair is not None for pair in row] for row in model.operator.pairs] == [[True, False], [False, True]]


def test_the_card_says_how_well_each_pair_is_known(coupled):
    known = coupled.cards[1].uncertainty
    mean, sd = known["step_response_8h_K[floor]"], known["step_response_8h_sd_K[floor]"]
    pair = coupled.operator.pairs[1][0]
    assert mean == pytest.approx(effect_K(pair) * pair.heat_input.reference_W / FULL_W, rel=1e-6)
    assert 0 < sd < mean


def test_a_building_comes_back_from_its_file(coupled, tmp_path):
    back = load_model(coupled.save(tmp_path / "house"))
    assert back.names == NAMES
    np.testing.assert_array_equal(back.operator.gains, coupled.operator.gains)
    assert back.power == coupled.power
    assert "floor" in back.summary()


def test_another_building_is_refused(coupled):
    other = replace(two_rooms(coupled=True), names=replace(NAMES, zones=("kitchen", "bed")))
    with pytest.raises(DataError, match="kitchen"):
        identify([other], config=LINEAR, layout=LAYOUT)
    with pytest.raises(DataError, match="say what acts where"):
        identify([other], config=LINEAR)


def test_order_of_the_zones_does_not_matter(coupled):
    r = two_rooms(coupled=True)
    turned = Record(
        r.time_s, r.T_zone_C[::-1], r.T_out_C, r.solar_W_m2, r.u[::-1], r.power_W[::-1], r.heat_W[::-1],
        names=Names(NAMES.zones[::-1], NAMES.actuators[::-1], NAMES.machines[::-1]),
    )  # fmt: skip
    model = identify([turned], config=LINEAR, layout=replace(LAYOUT, names=turned.names))
    np.testing.assert_allclose(
        model.operator.steady_gains_K[::-1, ::-1], coupled.operator.steady_gains_K, rtol=1e-5, atol=1e-9
    )


def test_what_is_known_together_and_not_apart_is_said():
    step_s = HOUR_S
    zones = [ZoneModel(linear_operator([0.9], [0.1], step_s=step_s), None, None, ModelCard()) for _ in range(2)]
    layout = replace(LAYOUT, floor_area_m2=(100.0, 60.0))
    across = Effect(np.log([10.0]), np.array([0.02]), np.full(7, 0.08))
    for together_sd, ending in ((0.12, "with all others together known to ± 12 %, apart not"), (0.9, "does to ")):
        building = assembled(
            layout, zones, [[across], []], [None, None], IdentificationConfig(), [0.0, 0.3], [together_sd, np.nan]
        )
        (note,) = building.cards[0].notes
        assert note.startswith(f"the record does not tell what {layout.names.actuators[1]} does to ")
        assert ending in note
        assert ("together" in note) == (together_sd < 0.5)
        assert building.cards[0].together_sd == together_sd
    name = layout.names.actuators[1]
    assert building.cards[0].uncertainty[f"step_response_24h_sd_K[{name}]"] > 0.08, "the heat of its level counts"
