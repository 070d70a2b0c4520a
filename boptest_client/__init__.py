"""Typed client for the BOPTEST REST protocol; knows nothing about control."""
