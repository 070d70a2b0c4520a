"""Free responses: forecasts of the zone temperature without control action. One file per method, see `registry`."""
