"""Machine models: heat and electric power as functions of level and weather."""
