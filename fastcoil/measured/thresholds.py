"""Calibrated thresholds of a diagnosis, and what fixed each.

``agreement``, ``grid`` and ``identify`` were calibrated on simulated valves and days of seeds below 9000: the tables of
``studies/diagnosis`` (``claims``, ``traps``, ``diagnosis``), of other seeds, show what their claims are
worth. ``studies/diagnosis/cause.py`` tests ``cause``, and ``studies/diagnosis/predictions.py`` ``fitted_loop``, which
was calibrated on loops of the seeds 501 and 601.
"""

# agreement: whether the command answers this temperature (table claims_misled)
MOST_UNEXPLAINED = 0.015  # share of the variance of the command's changes; as much again without a set-point
MOST_UNEXPLAINED_PER_SECOND = 1 / 2000  # such a share in a slow log, per second between samples
LARGEST_RESIDUAL_CORRELATION = 0.25  # of residuals a window apart: noise has less, another plant's temperature more
NEGLIGIBLE_UNEXPLAINED = 0.005  # share of the variance below which that correlation does not count
LEAST_CLOCK_EXPLAINED = 0.998  # of the command's moves, by a PI on the right clock; on others it leaves 4 times as much

# identify: what a day may claim (tables diagnosis_claims, claims_pooled)
LIKELIHOOD_WEIGHT = 0.8  # share of the log-likelihood that counts: residuals are neither independent nor normal
COMMAND_WEIGHT = 0.3  # share that counts where the command has coefficients of its own
POOLED_WEIGHT = 0.6  # share that counts of many days together
MANY_DAYS = 4  # number of days from which they are many
MOST_STEADY_WEIGHT = 6.0  # of all days with a constant set-point: the error of a linear model repeats itself
LEAST_AGREEMENT = 2.0  # standard errors between days by which they prefer a size to any other
LEAST_ODDS = 300.0  # of the most probable size against that of a good valve, to call a valve worse than good
UNSEEN_TURN_SHARE = 0.1  # share of itself by which a gap may be larger where samples miss reversals
LEAST_REVERSALS = 3  # larger than the gap; claims from fewer were all wrong in studies/least_movement
MOST_ARRIVALS = 10  # number of times that the command may arrive at an end
MOST_ARRIVALS_PER_REVERSAL = 0.2  # such arrivals over reversals of more than 5 % of the stroke
LARGEST_SHIFT_GAIN = 10.0  # rise of the log-likelihood with the clock shifted
LEAST_PLACEBO_MARGIN = 10.0  # of the log-likelihood above that of other hours and of the log backwards
MOST_BACK_AND_FORTH = 0.01  # share of samples at which the command moves back what it just moved
LARGEST_OUTSIDE_SWING = 15.0  # power of the residual at one period over its median power: white noise has less
LARGEST_LAG_RATIO = 1.25  # of what a PI leaves of the commands of all days over the least, at a lag that may be true
MOST_MISPLACED_SHARE = 0.2  # of the days, whose command is that of another loop, clock or direction
LEAST_OWN_EXPLAINED = 0.8  # of the command's changes: a PI of another temperature or clock explains less
JUMPY_WEIGHT = 0.5  # share of the likelihood that counts of a log with more of that

# diagnose: no size is claimed beyond these
WIDEST_COMMAND_SWING = 0.4  # fraction of stroke: the squared opening no longer follows the curve of a valve
LARGEST_INCREMENT_K = 0.06  # change that makes the log write a temperature: looks like a gap
WIDEST_INTERVAL = 0.1  # of the backlash, fraction of stroke

# cause: whether the fitted loop swings as logged (table diagnosis_answers)
LARGEST_GAP_SWING = 0.6  # of the command, fraction of stroke, that a gap may cause; beyond it the loop is unstable
LARGEST_MEASURED_GAP_SWING = 0.95  # such a swing where a test has measured the gap
GAIN_FACTORS = (1.0 / 1.1, 1.0, 1.1)  # on the gain of the model, which no log resolves exactly
LEAST_AGREEING_GAINS = 2  # number of ``GAIN_FACTORS`` with which the model has to swing as logged
LARGEST_PERIOD_RATIO = 1.6  # between the periods of model and log
LEAST_SWING_RATIO = 0.5  # swing of the model over that of the log
DISTURBANCE_GAIN_FACTOR = 1.25  # on the gain, with which a loop does not hunt either if a disturbance swings it
CLEAR_GAIN_FACTOR = 1.2  # on the gain, at which and at its inverse a loop hunts whose unidentified gap is clear
CALM_GAIN_FACTOR = 1.4  # on the gain, at which such a loop does not hunt without its gap
CLEAR_PERIOD_RATIO = 1.25  # largest ratio between the periods of such a loop and the log
CLEAR_SWING_RATIOS = (0.75, 2.0)  # least and largest swing of such a loop over that of the log
LARGEST_SWING_PER_GAP = 5.0  # of the command, in sizes of the gap that is blamed
WELL_EXPLAINED_SHARE = 0.9  # of the temperature's changes; below, a swing larger than the model's has another part
LARGEST_DISTURBANCE_PER_SWING = 2.0  # fast disturbances over the swing, beyond which they may hide it
LARGEST_REMAINING_SHARE = 0.5  # of a swing while the command is held, above which it comes from outside
LEAST_HOLD_PERIODS = 0.75  # for which the command is held, for a swing that stops to be the loop's
LARGEST_CALM_DRIFT_K = 0.25  # of the temperature while the command is held on a calm day

# fitted_loop: what is predicted (table diagnosis_predictions)
LARGEST_ERROR_LOG_RATIO = 0.2  # of replayed and logged control error, as a logarithm
LARGEST_TRAVEL_LOG_RATIO = 0.4  # of replayed and logged travel of the motor, as a logarithm
GAIN_ERROR_FACTOR = 1.15  # on the loop gain, more and less, with which a prediction must agree
LARGEST_ERROR_RATIO = 1.5  # between the control errors that are predicted with these loop gains

# valve_problem: 95 % intervals (tests/measured/test_halves.py and test_coarse_logs.py)
PART_SPREAD_FACTOR = 1.6  # on the spread of parts, with which halves of a log lie in the interval of the whole
LEAST_MOVING_SHARE = 0.4  # of the rows, with which a controller may move the valve between them
LARGEST_MOTION_SHARE = 0.5  # of the variance that the backlash explains, left by motion between the rows
ALLOWANCE_PER_MOTION_SHARE = 0.6  # of the backlash, times the root of that share, on both sides
LEAST_ALLOWANCE = 0.002  # of the backlash on both sides, fraction of stroke
TINY_RESIDUAL = 0.04  # share of the flow's change from row to row: motion between the rows leaves more
LITTLE_RESIDUAL = 0.12  # such a share where the backlash explains more than half of the residual without it
