"""What the figures of the documentation are measured by; beside the product in a checkout, not in the wheel.

A room a subject: `controller`, `closed_loop`, `zones`, `commands`, `fleet`, `faults`, `plant`, `operator`, `probing`,
`operation`, `measured_rooms`, `free_response`. The paper's suites are `factual` and `interventions`, `chaos` makes
troubles on purpose, `pretraining` trains the shipped forecaster, and `cli` has the commands `tf-mpc bench NAME` and
`tf-mpc chaos`.
"""

import thermoforce_mpc  # noqa: F401  # its switches, before any bench imports a dependency
