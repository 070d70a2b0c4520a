"""What FMUs made here and in tests share, and carry: points as BOPTEST declares them, for PythonFMU."""

from collections.abc import Iterable, Mapping

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class FmuWithPoints(Fmi2Slave):
    """A slave whose inputs and outputs are in two tables by name; `<point>_u` acts while `<point>_activate` is true."""

    author = "tests"

    def declare(self, overwrites: Mapping[str, float], outputs: Iterable[str]) -> None:
        """Inputs of each point with its value at the start, and outputs that begin at zero."""
        self._inputs: dict[str, float] = {}
        self._outputs = dict.fromkeys(outputs, 0.0)
        for name, value in overwrites.items():
            self._declare_input(Real, f"{name}_u", value)
            self._declare_input(Boolean, f"{name}_activate", False)
        for name in self._outputs:
            self.register_variable(
                Real(name, causality=Fmi2Causality.output, getter=lambda name=name: self._outputs[name]), nested=False
            )

    def _declare_input(self, kind: type, name: str, start: float) -> None:
        self._inputs[name] = start
        self.register_variable(
            kind(
                name,
                start=start,
                causality=Fmi2Causality.input,
                variability=Fmi2Variability.discrete,
                getter=lambda: self._inputs[name],
                setter=lambda value: self._inputs.__setitem__(name, value),
            ),
            nested=False,
        )

    def acting(self, name: str, native: float) -> float:
        """What acts at a point: its input where it is active."""
        return self._inputs[f"{name}_u"] if self._inputs[f"{name}_activate"] else native


class FmuRoom(FmuWithPoints):
    """A room that is simulated in steps of about 30 s by `simulate(dt_s)`."""

    def exit_initialization_mode(self) -> None:
        """The first readings."""
        self.simulate(0.0)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Simulate in parts."""
        n = max(round(step_size / 30.0), 1)
        for _ in range(n):
            self.simulate(step_size / n)
        return True
