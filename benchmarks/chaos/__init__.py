"""Fault injection: a run of the controllers on a served plant, with everything between and inside them failing."""
