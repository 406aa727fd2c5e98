"""What a trend log reveals.

``diagnosis``: the backlash; ``claims``: what misleads, and many days; ``traps``: polled points, late days, swings from
outside; ``cause``: why a loop swings; ``predictions``: what another valve or controller would do.
"""
