"""A local page to play with one loop.

``model``: settings in, numbers and sentences out; ``view``: figures and controls; ``server``: the page on this machine.
"""
