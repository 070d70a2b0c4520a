"""What a run says first of its outcome."""

from __future__ import annotations

from thermoforce_mpc.report.findings import verdict


def kpis(cost: float, discomfort: float) -> dict[str, float]:
    return {"cost_tot": cost, "tdis_tot": discomfort}


def test_cost_and_comfort_beside_those_of_the_baselines():
    said = verdict(
        "thermoforce_mpc",
        {"thermoforce_mpc": kpis(0.5975, 0.06), "native": kpis(0.88, 9.21), "thermostat": kpis(0.6425, 0.0)},
        "EUR",
        14.0,
    )
    assert said == (
        "thermoforce_mpc: 0.598 EUR/m², 7 % less than an on/off thermostat and 32 % less than the building's own "
        "controller; comfort missed by 0.06 K·h in two weeks (thermostat 0.00, native 9.21)."
    )


def test_a_controller_that_saves_by_being_cold_is_not_praised():
    said = verdict("ours", {"ours": kpis(0.4, 5.0), "thermostat": kpis(0.5, 0.1)}, "EUR", 3.0)
    assert said.endswith("It leaves more discomfort than thermostat: compare costs at equal comfort.")
    assert "in 3 days" in said


def test_equal_and_dearer_and_what_has_no_ratio():
    assert "as much as an on/off thermostat" in verdict(
        "ours", {"ours": kpis(0.5001, 0), "thermostat": kpis(0.5, 0)}, "EUR", 1.0
    )
    assert "20 % more than" in verdict("ours", {"ours": kpis(0.6, 0), "thermostat": kpis(0.5, 0)}, "EUR", 1.0)
    assert "0.02 EUR/m² less than" in verdict("ours", {"ours": kpis(-0.01, 0), "thermostat": kpis(0.01, 0)}, "EUR", 1.0)
    assert "0.01 EUR/m² more than" in verdict("ours", {"ours": kpis(0.01, 0), "thermostat": kpis(0.0, 0)}, "EUR", 1.0)


def test_alone_and_without_cost():
    assert verdict("ours", {"ours": kpis(0.5, 12.3)}, "USD", 7.0) == (
        "ours: 0.5 USD/m²; comfort missed by 12 K·h in one week."
    )
    assert "gives no cost" in verdict("ours", {"ours": {"ener_tot": 1.0}}, "USD", 7.0)
