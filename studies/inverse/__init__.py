"""When an inverse helps.

``conditions``: where the paper's observations hold; ``population``: how the benefit is distributed over valves.
"""
