"""The commands `tf-mpc bench NAME` and `tf-mpc chaos`; `thermoforce_mpc.cli` finds them where this package is there."""
