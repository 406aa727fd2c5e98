"""A local page to explore one loop, in reading order.

``loop``: the settings and the loops to start from; traces, metrics and an explanation of a loop.
``figures`` and ``page``: the page, with Bokeh, for each reader, on this machine only.
"""
