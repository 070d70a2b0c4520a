"""Plans of many buildings together: batches, portfolios, and the processes that make their plans."""
