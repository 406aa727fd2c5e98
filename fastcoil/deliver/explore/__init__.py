"""A local page to play with one loop, in reading order.

``settings``: what can be moved, and the loops to start from.  ``loop``: settings in, traces, metrics and an explanation
out.  ``figures`` and ``page``: the page, with Bokeh.
``server``: a page for each reader, on this machine alone.
"""
