"""What should find the backlash.

``learners_runs``, ``learners``: every estimator under many conditions; ``learning``, ``maps``: which learning rule to
ship; ``identify_online``: an estimator that provokes nothing.
"""
