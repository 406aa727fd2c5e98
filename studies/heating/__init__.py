"""Which coil and gains heating needs, and what backlash does there.

``heating``: sizing, gains, figure, ``main``; ``backlash``: worn valves, remedies, theory.
"""
