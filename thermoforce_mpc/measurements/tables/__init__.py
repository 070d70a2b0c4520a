"""Tables as they stand in files: columns, stamps, clock, screening, equal steps."""
