"""Several zones: effects of single actuators against the plant, and controllers that leave the cross-effects out."""
