"""What time step, volumes and air march do to results.

``numerics``: the presets, ``main``; ``populations``: valves and loops drawn at random, the coil at rest.
"""
