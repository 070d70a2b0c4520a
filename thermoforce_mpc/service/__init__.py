"""The embedded plant behind BOPTEST's REST protocol, for clients written for the real service."""
