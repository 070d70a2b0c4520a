"""Records of drawn houses with faults put into them, and whether the checks find and name these."""
