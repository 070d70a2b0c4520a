"""From levels of a plan to what an actuator is told: on/off blocks, held levels, room set-points."""
