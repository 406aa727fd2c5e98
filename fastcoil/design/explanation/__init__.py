"""Why one loop hunts, or does not: in words and one figure, with what would cure it and what that costs."""
