"""`python -m thermoforce_mpc`: the same as `tf-mpc`."""

from thermoforce_mpc.cli import main

if __name__ == "__main__":  # processes that are spawned import this module
    main()
