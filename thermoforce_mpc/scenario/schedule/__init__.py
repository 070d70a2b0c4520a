"""Times as people write them: dates, and comfort bounds by schedule."""
