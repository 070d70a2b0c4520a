"""FMUs: the emulator, and a small house that fails on purpose; the tests run them too."""
