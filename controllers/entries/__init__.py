"""What stands in the registry of controllers."""
