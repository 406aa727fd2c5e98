"""What finds the backlash estimate: one file for each estimator, with its memory and its step.

Read ``interface`` first, what an estimator is made of and sees, and ``learner``, the rule of the paper; ``hagglund``,
``gradient`` and ``identify`` are the others; ``registry`` finds them by name.
"""
