"""Solve times of the MPC problem beside do-mpc, and the parts of a control step."""
