"""Where the models of a run come from: probing, measurements, or a saved folder."""
