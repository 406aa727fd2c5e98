"""What may be said of a backlash, and done about it, from how well each candidate explains the temperature."""

from __future__ import annotations

from fastcoil.model.estimators.identify_equations import CANDIDATES, EARLIER, PROBABILITY, N
from fastcoil.model.numerics.elementary import exp
from fastcoil.model.numerics.jit import exact

WEIGHT = 0.6
"""Share of the log-likelihood that counts: residuals are neither independent nor normal."""
GOOD = 0.01
"""Up to this backlash a valve is called good and left alone; also the least tolerance of an estimate."""
TOLERANCE = 0.2
"""Of an estimate, as a share of it."""
NO_BACKLASH = 0.0051
"""Up to this size a candidate is no backlash."""
DOUBT, DOUBT_EARLIER = 0.005, 0.05
"""Largest probability of no backlash at which there is an estimate: on a good valve each does harm.  The second is by
the openings of earlier horizons, where the controller samples several times in one: there it answers the very change
that is to be explained, and a gap that filters its answer seems to explain the change."""
TOO_LARGE = 0.05
"""Largest probability of being not too large at which an estimate is given up."""


@exact
def right(candidate, estimate):
    """Whether an estimate is right if the backlash is this candidate."""
    tolerance = TOLERANCE * candidate if TOLERANCE * candidate > GOOD else GOOD
    return abs(candidate - estimate) <= tolerance + 1e-9


@exact
def normalise(w, at):
    """Turn the log-likelihoods at ``at`` into probabilities."""
    highest, total = w[at], 0.0
    for c in range(1, N):
        highest = w[at + c] if w[at + c] > highest else highest
    for c in range(N):
        w[at + c] = exp(WEIGHT * (w[at + c] - highest))
        total += w[at + c]
    for c in range(N):
        w[at + c] /= total


@exact
def judged(w, kept, certainty, answers):
    """The estimate after a comparison.

    It is the mean of the probabilities if that is right with this certainty, 0 for a good valve.  Otherwise it is what
    was kept, unless that is nearly certainly too large.  answers: whether the controller samples several times in a
    horizon.
    """
    normalise(w, PROBABILITY)
    normalise(w, EARLIER)
    mean, is_right, is_none, is_none_earlier, is_as_large = 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(N):
        mean += w[PROBABILITY + c] * CANDIDATES[c]
    mean = 0.0 if mean <= GOOD else mean
    for c in range(N):
        p = w[PROBABILITY + c]
        is_right += p if right(CANDIDATES[c], mean) else 0.0
        is_as_large += p if CANDIDATES[c] >= kept or right(CANDIDATES[c], kept) else 0.0
        is_none += p if CANDIDATES[c] <= NO_BACKLASH else 0.0
        is_none_earlier += w[EARLIER + c] if CANDIDATES[c] <= NO_BACKLASH else 0.0
    has_backlash = is_none <= DOUBT and (is_none_earlier <= DOUBT_EARLIER or not answers)
    if is_right >= certainty and (mean == 0.0 or has_backlash):
        return mean
    return (mean if has_backlash else 0.0) if is_as_large <= TOO_LARGE else kept
