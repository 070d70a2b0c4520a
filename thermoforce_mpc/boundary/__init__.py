"""What surrounds the building besides weather: tariffs, scored windows, errors of the forecast."""
