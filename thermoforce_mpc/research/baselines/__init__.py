"""Plain forecasters that the benches compare the product's free responses with. One file per method."""
