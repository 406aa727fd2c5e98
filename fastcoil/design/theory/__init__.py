"""Linear theory of the loop: the plant at rest, its answer to a small step, and what follows for the loop."""
