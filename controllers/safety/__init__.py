"""What keeps a building in control where a plan fails or must not act: overrides, fallback, deadlines."""
