"""Controllers side by side: every controller on every window under every tariff, in parallel processes, resumable."""
