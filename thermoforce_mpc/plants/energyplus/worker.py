"""Process of one run of the engine, started by `process.EngineProcess`."""

from __future__ import annotations

from thermoforce_mpc.plants.energyplus.live import Live
from thermoforce_mpc.plants.energyplus.simulate import run_engine
from thermoforce_mpc.plants.worker_process import Failed, channel


def main() -> None:
    """Run the `Building` of the first request, and answer what it is told."""
    receive, send = channel()
    building = receive()
    try:
        run_engine(building.model(), building.weather(), Live(building, receive, send), building.wiring())
    except Exception as error:  # any error is reported by the client
        send(Failed(error))


if __name__ == "__main__":
    main()
