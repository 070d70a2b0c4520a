"""Commands that go on in real time: control, watch, serve."""
