"""Commands: what people and home automation can set, and the map from a command to a level of heat.

A new kind of command is one file here, with a line in `kinds.py`.
"""
