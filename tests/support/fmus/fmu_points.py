"""What the FMUs of the tests share: points as BOPTEST declares them, for PythonFMU. Travels inside each FMU."""

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class FmuWithPoints(Fmi2Slave):
    """A slave whose inputs and outputs are in two tables by name; `<point>_u` acts while `<point>_activate` is true."""

    author = "tests"

    def declare(self, overwrites, outputs):
        """Inputs of each point with its value at the start, and outputs that begin at zero."""
        self._inputs, self._outputs = {}, dict.fromkeys(outputs, 0.0)
        for name, value in overwrites.items():
            self._declare_input(Real, f"{name}_u", value)
            self._declare_input(Boolean, f"{name}_activate", False)
        for name in outputs:
            self.register_variable(
                Real(name, causality=Fmi2Causality.output, getter=lambda name=name: self._outputs[name]), nested=False
            )

    def _declare_input(self, kind, name, start):
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

    def acting(self, name, native):
        """What acts at a point: its input where it is active."""
        return self._inputs[f"{name}_u"] if self._inputs[f"{name}_activate"] else native


class FmuRoom(FmuWithPoints):
    """A room that is simulated in steps of about 30 s by `simulate(dt_s)`."""

    def exit_initialization_mode(self):
        self.simulate(0.0)

    def do_step(self, current_time, step_size):
        n = max(round(step_size / 30.0), 1)
        for _ in range(n):
            self.simulate(step_size / n)
        return True
