"""Tables of measurements, as people have them, to records: map, files, clock, units, screening, resampling."""
