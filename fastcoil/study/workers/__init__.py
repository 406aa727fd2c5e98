"""Where shards run, and what happens when a worker dies."""
