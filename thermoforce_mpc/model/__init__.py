"""The thermal model of a building: operator, machine, free response, and their sum."""
