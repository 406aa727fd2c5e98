"""The paper, figure by figure and claim by claim: `fastcoil paper` draws and prints what is computed here.

``grid``: the simulations, on tunings and kinds of days.  ``claims``: what the paper says, and when it counts as
holding.
``scorecard``: the share of the grid in which each claim holds, and the region of tunings in which it does.
"""
