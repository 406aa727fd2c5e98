"""What a valve test shows.

``valve_test``: the gap; ``bound``, ``optimised``: how well it could; ``online``: every week; ``blame``: why loops hunt.
"""
