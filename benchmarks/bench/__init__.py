"""Benches, run by `tf-mpc bench NAME [--quick] [--json FILE]`; all return the JSON format of `bench_result`."""
