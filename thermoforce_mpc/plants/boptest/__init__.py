"""Plant behind the BOPTEST REST service."""
