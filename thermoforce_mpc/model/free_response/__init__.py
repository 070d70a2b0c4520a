"""Free responses: what the zone would do without us. One file per method, named in `registry`."""
