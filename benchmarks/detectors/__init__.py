"""`tf-mpc bench detectors`: what detectors do where there is nothing to detect, and where there is."""
