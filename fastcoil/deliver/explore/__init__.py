"""A local page to play with one loop, in reading order.

``settings``: what can be moved, and the loops to start from.  ``loop``: settings in, traces, metrics and predictions
out.  ``words``: what is seen, in sentences, as Python and as a study file.  ``figures`` and ``page``: the Bokeh page.
``server``: one session per reader, on this machine alone.
"""
