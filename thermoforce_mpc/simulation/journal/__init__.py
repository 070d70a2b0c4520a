"""The journal of a run, and what it tells a resumed one."""
