"""What the machine gives and takes: heat and electric power as functions of level and weather."""
