"""What is kept of a run: its folder, its journal, and what is told again from it."""
