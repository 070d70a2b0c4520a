"""What people see of a run: progress, decisions, live view, report made again."""
