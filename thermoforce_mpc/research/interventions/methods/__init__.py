"""Methods that answer what an action would do. One file per method, named in `registry`."""
