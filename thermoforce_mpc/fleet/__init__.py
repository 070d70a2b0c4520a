"""Many buildings × windows × tariffs × controllers × seeds, as one dataset and one page."""
