"""Configuration files: settings, test cases and scenarios."""
