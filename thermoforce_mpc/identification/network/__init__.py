"""Rooms as networks of conductances and capacities, estimated by maximum likelihood of one-step prediction errors."""
