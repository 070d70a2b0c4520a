"""A building behind the BOPTEST REST service."""
