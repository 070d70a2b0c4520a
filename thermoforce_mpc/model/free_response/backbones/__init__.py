"""Frozen time-series foundation models behind one interface. One file per family; `loading` loads them by name."""
