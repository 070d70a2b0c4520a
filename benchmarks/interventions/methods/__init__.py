"""Methods that predict the effect of actions. One file per method, listed in `registry`."""
