"""limit_cycle: loops x days x seconds -> margin, and whether, how fast and how far each hunts; its Nyquist plot."""

from __future__ import annotations

import json
import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arrays import Array, Index, Mask
from fastcoil.base.errors import InputError
from fastcoil.base.figures import COLOURS, DOTTED, LINE_STYLES, apply_style, wrapped
from fastcoil.design.describing_function import Elements, amplitude_of, between, limited, refined, too_smooth, unknown
from fastcoil.design.linearise import at_180
from fastcoil.design.operating_points import OperatingPoints, require_pi
from fastcoil.design.plants import Columns, Complex, Plants, distinct, driven_gain, frequency_response, loop_response
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.labels import label_in_words
from fastcoil.loops.loop import Loop
from fastcoil.loops.provenance import provenance
from fastcoil.model.metric_table import HUNTING_SWING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_HALVINGS = 10
_FLAT = 0.01  # A rise of the phase, rad, from which a loop has more than one frequency for a phase


Describing = Callable[[Array], Complex]
"""Frequencies, rad/s, of loops and amplitudes → the describing function there."""


class Balance(NamedTuple):
    """Of each piece of the phase curves, loop and amplitude, (3, n, n_amplitudes).

    product: |L| |N| where L and N lag 180° together; 0 where they do nowhere.  place: where between the frequencies
    that is, as an index with a fraction.  size: |N|.
    """

    product: Array
    place: Array
    size: Array


def frequency(w: Array, place: Array) -> Array:
    """Frequencies at places between those of w, which ascend by equal ratios."""
    return np.asarray(w[0] * np.exp(place * np.log(w[1] / w[0])))


def balance(w: Array, L: Complex, N: Callable[[Index], Describing], n_amplitudes: int, lead: Array) -> Balance:
    """Where L and N lag 180° together, for each loop and amplitude.

    With fast integral action the phase of L falls, rises and falls again: the three pieces are kept apart.  In a loop
    where it only falls, all of it is the first piece.

    w: rad/s, (n_w,), ascending by equal ratios.  L: linear part of the loops, (n, n_w).  N: which m loops → their
    describing function at frequencies, (m, n_amplitudes).  lead: most that N may lead, rad, (n,).
    """
    left, log_L, found = np.pi + np.unwrap(np.angle(L), axis=1), np.log(np.abs(L)), []
    for low, high, turn in _pieces(left, lead):
        some = np.flatnonzero(high > low)  # the loops that have this piece
        a, b = (np.repeat(end[:, None].astype(float), n_amplitudes, axis=1) for end in (low, high))
        product, place, size = np.zeros(a.shape), a.copy(), np.zeros(a.shape)
        if some.size:
            phase, of = left[some], N(some)

            def excess(at: Array, turn: float = turn, phase: Array = phase, of: Describing = of) -> Array:
                return turn * (between(phase, at) + np.angle(of(frequency(w, at))))

            at, there = _root(excess, a[some], b[some])
            place[some], size[some] = at, np.abs(of(frequency(w, at)))
            product[some] = np.where(there, np.exp(between(log_L[some], at)) * size[some], 0.0)
        found.append((product, place, size))
    product, place, size = (np.stack(part) for part in zip(*found, strict=True))
    return Balance(product, place, size)


def _root(excess: Callable[[Array], Array], a: Array, b: Array) -> tuple[Array, Mask]:
    """Where a falling function crosses 0 between a and b, and whether it does."""
    fa, fb = excess(a), excess(b)
    there = (fa >= 0.0) & (fb <= 0.0) & (b > a)
    for _ in range(_HALVINGS):
        x = 0.5 * (a + b)
        fx = excess(x)
        right = fx > 0.0
        a, fa, b, fb = np.where(right, x, a), np.where(right, fx, fa), np.where(right, b, x), np.where(right, fb, fx)
    steep = np.where(fa > fb, fa - fb, 1.0)
    return a + (b - a) * np.clip(fa / steep, 0.0, 1.0), there


def _pieces(left: Array, lead: Array) -> list[tuple[Index, Index, float]]:
    """First and last index of the last fall of each curve, of a first one and of the rise between; -1 for the rise."""
    n, n_w = left.shape
    rows = np.arange(n)
    over = left < -lead[:, None]
    last = np.where(over.any(axis=1), over.argmax(axis=1), n_w - 1)
    seen = np.where(np.arange(n_w) <= last[:, None], left, -np.inf)
    later = np.maximum.accumulate(seen[:, ::-1], axis=1)[:, ::-1]
    rise = np.where(np.isfinite(seen), later, 0.0) - np.where(np.isfinite(seen), seen, 0.0)
    dip = rise.argmax(axis=1)
    bumps = rise[rows, dip] > _FLAT
    dip = np.where(bumps, dip, 0)
    peak = np.where(np.arange(n_w) >= dip[:, None], seen, -np.inf).argmax(axis=1)
    peak = np.where(bumps, peak, 0)
    return [(peak, last, 1.0), (np.zeros_like(dip), dip, 1.0), (dip, peak, -1.0)]


class Points(NamedTuple):
    """Swings in which the phases of L and N add up to -180°.

    product: |L| |N|.  w: rad/s.  u: amplitude of u, fraction of stroke.  T: amplitude of T_sup, K.
    """

    product: Array
    w: Array
    u: Array
    T: Array


def started(points: Points, disturbance: float) -> tuple[Mask, Points]:
    """The cycle at which a swing of T_sup with the amplitude ``disturbance``, K, ends: whether there is one, and it.

    Where |L| |N| falls through 1 as the amplitude grows, a larger swing decays and a smaller one grows: that cycle
    sustains itself.  Where it rises through 1, it parts the swings that grow from those that decay (Gelb and Vander
    Velde 1968, section 3.2).  Where the phase of L rises with the frequency it is the other way round.

    points: (3, n, n_amplitudes) each, of the pieces of ``harmonic_balance``.
    """
    F = points.product
    before, after = F[:, :, :-1], F[:, :, 1:]
    both = (before > 0.0) & (after > 0.0)
    falls, rises = (before >= 1.0) & (after < 1.0), (before < 1.0) & (after >= 1.0)
    other_way = np.array([False, False, True])[:, None, None]
    stable, parts = np.where(other_way, rises & both, falls), np.where(other_way, falls, rises)
    log_F = np.log(np.maximum(F, 1e-9))
    crossing = both & (stable | parts)
    # where the phases meet no more, the cycle is at the last amplitude at which they do
    share = np.where(crossing, -log_F[:, :, :-1] / np.where(crossing, np.diff(log_F, axis=2), 1.0), 0.0)

    def there(values: Array) -> Array:
        log = np.log(np.maximum(values, 1e-12))
        between_them = np.exp(log[:, :, :-1] * (1.0 - share) + log[:, :, 1:] * share)
        return np.asarray(_in_a_row(between_them))

    at = Points(*map(there, points))
    is_stable, is_parting, is_above = _in_a_row(stable), _in_a_row(parts), at.T > disturbance
    above, below = np.where(is_stable & is_above, at.T, np.inf), np.where(is_stable & ~is_above, at.T, -np.inf)
    parting_above = np.where(is_parting & is_above, at.T, np.inf).min(axis=1)
    parting_below = np.where(is_parting & ~is_above, at.T, -np.inf).max(axis=1)
    nearest_above, nearest_below = above.min(axis=1), below.max(axis=1)
    nothing_below = (nearest_below == -np.inf) & (parting_below == -np.inf)
    grows = (parting_below > nearest_below) | (nothing_below & (nearest_above < parting_above))
    k = np.where(grows, above.argmin(axis=1), below.argmax(axis=1))
    goes_on = np.where(grows, nearest_above < np.inf, nearest_below > -np.inf)
    return goes_on, Points(*(values[np.arange(k.size), k] for values in at))


HUNTS_ABOVE = 0.85
"""Margin from which a gap keeps a loop swinging for hours, though in the end it may come to rest."""
OF_A_GAP = 1.5
"""Amplitude of u over the gap up to which that is so: there the gap shapes the swing."""
DISTURBANCE = 2.0
"""Amplitude of T_sup, K, of the disturbance that a cycle is started by."""
UNSTABLE = 1.02
"""|L| at 180° above which a loop is unstable without a gap, and a little, by which that may be wrong."""
NO_GAP = 1e-6
"""A gap or a buffer up to this size is round-off."""
MOST = 30.0
"""Largest amplitude of u that is looked at, before u is limited to 0–1."""
_AMPLITUDES, _FREQUENCIES = 44, 136
ROUNDS = 2
"""How often a cycle that reaches an end of the integral is computed again."""
_NEAR_ONE = 0.7
_SLOWEST = 3e-4  # lowest frequency, rad/s: a period of 6 h
_AT_ONCE = 512


class Cycles(NamedTuple):
    """Margin and limit cycle of each loop, (n,).

    margin: largest |L| |N|, where L and N lag 180° together, over the swings of T_sup of up to ``DISTURBANCE``; without
    a gap, 1 over the gain margin.  0 where the two never do, or no opening holds the set-point.
    hunts: 1 where a disturbance starts a swing of more than 0.1 K from peak to peak that goes on, else 0.
    period: s.  amplitude: half of peak to peak of true T_sup, K.  NaN where it does not hunt.
    frequency: of the margin, rad/s.
    """

    margin: Array
    hunts: Array
    period: Array
    amplitude: Array
    frequency: Array


def cycles_of(columns: Columns, plants: Plants) -> Cycles:
    """Predict margin and limit cycle; all NaN where theory says nothing (see ``unknown``), or a plant has no gain.

    columns: parameter name → (n,), see ``columns_of``.  plants: of these loops, see ``plants_of``.
    """
    n = plants.opening.size
    periods = np.asarray(columns["sample_time"], float)
    known = ~np.any(list(unknown(columns).values()), axis=0) & np.isfinite(plants.gain)
    found = Cycles(*(np.full(n, np.nan) for _ in Cycles._fields))
    # where no opening holds the set-point, or the loop acts the wrong way round or not at all, the valve stands
    acts = plants.reachable & (driven_gain(columns, plants) > 0.0) & (np.asarray(columns["kp"], float) > 0.0)
    found.margin[known & ~acts], found.hunts[known & ~acts] = 0.0, 0.0
    for period in np.unique(periods):
        members = np.flatnonzero(known & acts & (periods == period))
        for first in range(0, members.size, _AT_ONCE):
            some = members[first : first + _AT_ONCE]
            part = _of_one_period({name: values[some] for name, values in columns.items()}, plants.some(some), period)
            for values, of_part in zip(found, part, strict=True):
                values[some] = of_part
    return found


def _of_one_period(columns: Columns, plants: Plants, period: float) -> Cycles:
    """Of loops with one sample time."""
    w = np.geomspace(_SLOWEST, np.pi / period, _FREQUENCIES)
    L = loop_response(columns, plants, w)
    plants = plants._replace(curve=refined(plants.curve))
    elements = Elements.of(columns, plants)
    A = elements.amplitudes(MOST, _AMPLITUDES)
    of = _balanced(w, L, elements, A, plants)
    at = frequency(w, of.place)
    T = A * of.size * _response(plants, w, of.place) / (1.0 - elements.backlash)
    T *= np.abs(np.sinc(at * period / (2.0 * np.pi)))
    whole = Points(of.product, at, np.broadcast_to(A, T.shape), T)
    points = Points(*map(_in_a_row, whole))
    rows = np.arange(A.shape[0])
    best = np.where(points.T <= DISTURBANCE, points.product, 0.0).argmax(axis=1)
    # without a gap, that of the smallest swing: the linear loop's
    has_none = (np.abs(elements.width) <= NO_GAP)[:, 0] & (elements.wait <= NO_GAP)[:, 0]
    smallest = np.arange(0, points.product.shape[1], _AMPLITUDES)
    best = np.where(has_none, smallest[points.product[:, smallest].argmax(axis=1)], best)
    margin, w_margin = points.product[rows, best], points.w[rows, best]
    # a gap is crossed the more slowly the smaller the error: a swing that dies away takes hours
    shaped = (points.u < OF_A_GAP * elements.width) & (points.product > HUNTS_ABOVE)
    slow = np.where(shaped, points.product, 0.0).argmax(axis=1)
    lingers = shaped[rows, slow]
    goes_on, cycle = started(whole, DISTURBANCE)
    lingering = Points(*(values[rows, slow] for values in points))
    cycle = Points(*(np.where(goes_on, values, late) for values, late in zip(cycle, lingering, strict=True)))
    swing = np.full(A.shape[0], np.nan)

    def seen(found: Index) -> Mask:
        if found.size:
            u, part = cycle.u[found, None], elements.some(found)
            swing[found] = amplitude_of(u, part.mean(u), cycle.w[found, None], part, plants.some(found))
        return 2.0 * swing > HUNTING_SWING

    hunts = seen(np.flatnonzero(goes_on | lingers))
    # an unstable loop swings from end to end, also where no balance is found, such as in a cycle of two samples
    size, w_180 = at_180(L, w)
    runs_away = ~hunts & (size * elements.slope[:, 0] > UNSTABLE)
    ends = Points(size, w_180, np.full(size.size, MOST), size)
    cycle = Points(*(np.where(runs_away, far, values) for values, far in zip(cycle, ends, strict=True)))
    hunts = seen(np.flatnonzero(runs_away))

    seen_u, seen_w = np.where(hunts, cycle.u, points.u[rows, best]), np.where(hunts, cycle.w, w_margin)
    known = ~too_smooth(columns, seen_u, seen_w)
    hunts_known = hunts & known
    return Cycles(
        np.where(known, margin, np.nan), np.where(known, hunts.astype(float), np.nan),
        np.where(hunts_known, 2.0 * np.pi / cycle.w, np.nan), np.where(hunts_known, swing, np.nan),
        np.where(known & (margin > 0.0), w_margin, np.nan),
    )  # fmt: skip


def _balanced(w: Array, L: Complex, elements: Elements, A: Array, plants: Plants) -> Balance:
    """Balance of the loops; where the integral reaches an end, again with what that changes, at the frequency found."""
    mean = elements.mean(A)
    passed = limited(A, -mean, 1.0 - mean).astype(complex)

    def of(some: Index) -> Balance:
        part = elements.some(some)
        leads = (part.width < part.wait - NO_GAP)[:, 0] | (np.angle(passed[some]).max(axis=1) > 0.0)
        lead = np.where(leads, 0.5 * np.pi, 0.0)

        def N(which: Index) -> Describing:
            members = some[which]
            return elements.some(members).described(A[members], passed[members])

        return balance(w, L[some], N, _AMPLITUDES, lead)

    found = of(np.arange(A.shape[0]))
    room = np.minimum(mean, 1.0 - mean)
    reaches = elements.parts(A, frequency(w, found.place[0]))[1] > room
    ended = np.flatnonzero((reaches & (found.product[0] > _NEAR_ONE)).any(axis=1))
    for _ in range(ROUNDS if ended.size else 0):
        at = frequency(w, found.place[0][ended])
        part = elements.some(ended)
        reaches = part.parts(A[ended], at)[1] > room[ended]
        passed[ended] = np.where(reaches, part.passed(A[ended], at, plants.some(ended))[0], passed[ended])
        for values, again in zip(found, of(ended), strict=True):
            values[:, ended] = again
    return found


def _response(plants: Plants, w: Array, place: Array) -> Array:
    """|T_sup| per opening at places between frequencies w; smooth, so that every fifth of them is enough."""
    first, which = distinct(plants.same)
    some = np.linspace(0.0, w.size - 1.0, (w.size + 4) // 5)
    G = np.abs(frequency_response(plants.response[first], frequency(w, some)))
    log_G = np.log(np.maximum(G, 1e-300))[which]
    return np.exp(np.stack([between(log_G, piece * (some.size - 1.0) / (w.size - 1.0)) for piece in place]))


def _in_a_row(values: np.ndarray) -> np.ndarray:
    return values.transpose(1, 0, 2).reshape(values.shape[1], -1)


_NAMES: Mapping[str, Mapping[str, str]] = {
    "margin": {
        "long_name": "margin of the describing function", "units": "1",
        "comment": f"largest |L| |N| where L and N lag 180 degrees together, over swings up to {DISTURBANCE:g} K; from "
        f"{HUNTS_ABOVE:g} on a gap keeps the loop swinging; without a gap 1/gain margin; 0 if T_set is out of reach",
    },
    "hunts": {
        "long_name": "whether the loop is predicted to hunt", "units": "1",
        "comment": f"1 if a swing of {DISTURBANCE:g} K ends in one that goes on, by more than 0.1 K from peak to peak",
    },
    "period": {"long_name": "period of the predicted cycle", "units": "s", "comment": "NaN where it does not hunt"},
    "amplitude": {
        "long_name": "amplitude of T_sup in the predicted cycle", "units": "K",
        "comment": "half of peak to peak; NaN where it does not hunt",
    },
    "frequency": {"long_name": "angular frequency of the margin", "units": "rad s-1"},
}  # fmt: skip


def limit_cycle(loop: Loop, boundary: Boundary, *, at: Any = None) -> xr.Dataset:
    """Predict, without simulating, whether each loop hunts on each day, how fast and how far.

    The loop is linear but for one element, the describing function of all that lies between the controller's u and the
    supply temperature at rest: limits of the stroke, the motor's speed, neutral zone, gap, inverse with a right or
    wrong estimate, buffer, and the curve of valve and coil.  Noise and the resolutions are left out.

    Parameters
    ----------
    loop, boundary
        As for ``simulate``; a sweep and several days give results of these dims.
    at
        Where on the day: None for the mean conditions and the mean set-point of the enabled seconds after the warm-up
        of 1,800 s; a second, or a list of them, for the conditions of that second, as if they were held for ever.  A
        list becomes the dim ``elapsed_time``.

    Returns
    -------
    xarray.Dataset
        margin, hunts (0 or 1), period [s], amplitude [K, half of peak to peak, of true T_sup], frequency of the margin
        [rad/s].  The attributes of each say what it is.  All are NaN, with a warning that says why, in scenarios about
        which theory says nothing: a law of your own, an estimator that changes the estimate, stick-slip, an error dead
        band, a smooth compensation slower than the cycle.

    Raises
    ------
    InputError
        With one sentence for each mistake; for an unstable coil; if theory says nothing about any scenario.
    """
    points = OperatingPoints(loop, boundary, at)
    reasons: Counter[str] = Counter()

    def cycles(columns: Columns, _: Mapping[str, Array], plants: Plants) -> Iterable[tuple[str, Array]]:
        found, why = cycles_of(columns, plants), unknown(columns)
        why |= {"T_sup jumps past the set-point, from dry to wet: there is nothing to linearise": np.isnan(plants.gain)}
        slow = np.isnan(found.hunts) & ~np.any(list(why.values()), axis=0)
        slower = "the smooth compensation crosses the gap more slowly than u reverses"
        why[f"{slower}: lower smooth_rate, or simulate it"] = slow
        reasons.update({reason: int(where.sum()) for reason, where in why.items()})
        return found._asdict().items()

    found = points.evaluated(cycles)
    why, nothing = {reason: count for reason, count in reasons.items() if count}, np.isnan(found["hunts"])
    if nothing.all():
        raise InputError([f"limit_cycle says nothing about these loops: {reason}" for reason in why])
    note = "; ".join(f"NaN in {count:,} of {nothing.size:,} scenarios: {reason}" for reason, count in why.items())
    if note:
        warnings.warn(note, stacklevel=2)
    ds = points.dataset({name: (values, _NAMES[name]) for name, values in found.items()})
    about = {"parameters": json.dumps(points.loop.constants)} | ({"note": note} if note else {})
    return ds.assign_attrs(title="fastcoil limit cycles, predicted", **about, **provenance())


_LOWEST, _OF_CURVES = 1e-6, 4000  # frequencies of the curves: the lowest, rad/s, and their number
_REACH = 3.0  # A Nyquist plot shows this much of the plane to the left and below
_READING = (
    "Thick: L. Thin: -1/N. A loop hunts where L reaches -1/N, or nearly. One dot: the cycle. Two dots: the frequency "
    "at which a loop that does not hunt comes nearest to one."
)
_OF_ELEMENT, _SMALLEST = 400, 1e-3  # number of amplitudes, and least |N| that is drawn
_WIDTH = 6.5  # inches


@apply_style()
def nyquist(loop: Loop, boundary: Boundary, *, at: Any = None) -> Figure:
    """Draw the open loop L in the complex plane, with -1/N(A) and the margin between the two.

    N(A) is the describing function, for an input that swings by A, of all that lies between the controller and the
    supply temperature and is not linear: see ``limit_cycle``.  Up to three loops.

    Parameters
    ----------
    loop, boundary, at
        As for ``linearise``.

    Raises
    ------
    InputError
        With one sentence for each mistake; for more loops than a figure shows.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, 5.6), layout="constrained")
    axes = figure.subplots()
    axes.axhline(0.0, color="black", lw=0.6)
    axes.axvline(0.0, color="black", lw=0.6)
    turn = np.linspace(0.0, 2.0 * math.pi, 200)
    axes.plot(np.cos(turn), np.sin(turn), color="black", lw=0.8, ls=DOTTED)
    axes.plot(-1.0, 0.0, "+", color="black", ms=9)
    for (words, columns, plant), colour, line in zip(_loops(loop, boundary, at), COLOURS, LINE_STYLES, strict=False):
        # up to the highest frequency that the controller can make
        w = np.geomspace(_LOWEST, math.pi / float(columns["sample_time"][0]), _OF_CURVES)
        L = loop_response(columns, plant, w)[0]
        cycles = cycles_of(columns, plant)
        margin, hunts = float(cycles.margin[0]), bool(cycles.hunts[0] > 0.0)
        critical = float(2.0 * math.pi / cycles.period[0] if hunts else cycles.frequency[0])
        minus_1_over_N = _minus_1_over_N(columns, plant, critical)
        answer = f"margin {margin:.2g}, {'hunts' if hunts else 'does not hunt'}"
        near = np.abs(L) < 3.0 * _REACH
        label = f"{words}{answer if minus_1_over_N.size else 'not predicted'}"
        axes.plot(L.real[near], L.imag[near], color=colour, ls=line, label=label)
        axes.plot(minus_1_over_N.real, minus_1_over_N.imag, color=colour, lw=0.7, label="_-1/N")
        if margin > 0.0:
            on_L = complex(np.interp(critical, w, L))  # where the loop hunts, or comes nearest to it
            pair = np.array([on_L] if hunts else [on_L, on_L / margin])
            axes.plot(pair.real, pair.imag, color=colour, lw=0.8, ls=DOTTED, marker="o", ms=3.5)
    axes.set(xlim=(-_REACH, 1.2), ylim=(-_REACH, 1.2), aspect="equal", xlabel="real part", ylabel="imaginary part")
    axes.legend(loc="upper left", framealpha=0.8, edgecolor="none")
    axes.set_title(wrapped(_READING, 0.75 * _WIDTH, 9), loc="left")
    return figure


def _loops(loop: Loop, boundary: Boundary, at: Any) -> Iterator[tuple[str, Columns, Plants]]:
    """What the legend calls each loop, with a colon behind, its parameters and its plant."""
    points = OperatingPoints(loop, boundary, at)
    require_pi(points.loop)
    if points.size > len(COLOURS):
        raise InputError(f"{points.size} loops: a figure shows up to {len(COLOURS)}, select some")
    index = np.arange(points.size)
    columns, plants = points.columns(index), points.plants(index)
    labelled = points.dataset({})
    for k, place in enumerate(np.ndindex(*points.sizes.values())):
        labels = [label_in_words(labelled, dim, i) for dim, i in zip(points.sizes, place, strict=True)]
        words = ", ".join([*labels, *([] if plants.reachable[k] else ["set-point out of reach"])])
        one = {name: values[k : k + 1] for name, values in columns.items()}
        yield f"{words}: " if words else "", one, plants.some(index[k : k + 1])


def _minus_1_over_N(columns: Columns, plant: Plants, at: float) -> Complex:
    """-1/N over the amplitude of u, at a frequency [rad/s]; empty where theory says nothing."""
    if not math.isfinite(at):
        return np.empty(0, complex)
    elements = Elements.of(columns, plant)
    amplitudes = elements.amplitudes(MOST, _OF_ELEMENT)
    mean = elements.mean(amplitudes)
    N = elements.described(amplitudes, limited(amplitudes, -mean, 1.0 - mean))(np.array(at))[0]
    return np.asarray(-1.0 / N[np.abs(N) > _SMALLEST])
