"""The modulation of the gain: when it is trained, on what, and whether it is kept."""
