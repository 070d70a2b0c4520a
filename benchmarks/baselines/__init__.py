"""Baseline forecasters that the benches compare with the free responses of the package. One file per method."""
