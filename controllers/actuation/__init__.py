"""From levels of a plan to signals of actuators: on/off blocks, held levels, room set-points."""
