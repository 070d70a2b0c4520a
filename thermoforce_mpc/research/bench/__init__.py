"""Benches: every one is `tf-mpc bench NAME [--quick] [--json FILE]` and returns one JSON shape (see `result`)."""
