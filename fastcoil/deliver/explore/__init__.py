"""A local page to play with one loop, in reading order.

``loop``: what can be moved, and the loops to start from; settings in, traces, metrics and an explanation out.
``figures`` and ``page``: the page, with Bokeh, for each reader, on this machine alone.
"""
