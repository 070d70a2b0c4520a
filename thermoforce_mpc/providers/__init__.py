"""Weather and prices from services that are asked only where they are configured."""
