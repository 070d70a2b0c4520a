"""What users write: settings, test cases and scenarios."""
