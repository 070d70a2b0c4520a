"""Questions to records and models: what another schedule would have done, and what a changed operation saved."""
