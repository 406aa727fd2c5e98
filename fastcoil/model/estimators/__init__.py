"""Estimators of the backlash: one file for each, with its memory and its step.

Read ``interface`` first, the class of estimators, and ``learner``, the rule of the paper; ``hagglund``,
``gradient`` and ``identify`` are the others; ``registry`` finds them by name.
"""
