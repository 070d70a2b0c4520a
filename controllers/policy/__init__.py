"""Policies that were trained in an environment of `thermoforce_mpc.gym`, as controllers."""
