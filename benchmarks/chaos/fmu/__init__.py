"""The emulator as an FMU that fails on purpose; the tests run it too."""
