"""What a trend log reveals.

``diagnosis``: the backlash; ``cause``: why a loop swings; ``predictions``: what another valve or controller would do.
"""
