"""The PI controller and the backlash inverse."""

from reference.rounding import clip

RISING, FALLING = 1, -1


def pi_controller(error, integral, kp, ti, sample_time):
    """One sample of the PI law: (u, integral), both fractions.

    error [K] is positive when the valve should open; kp in 1/K, ti and sample_time in s.
    """
    integral = clip(integral + kp * sample_time / ti * error, 0.0, 1.0)
    u = clip(kp * error + integral, 0.0, 1.0)
    return u, integral


def backlash_inverse(u, estimate, buffer, mode, u_extreme, command):
    """Inverse of Eq (1) with a buffer on the change of direction: (command, mode, u_extreme).

    u is the desired opening; estimate, buffer, u_extreme (the furthest u in the present direction) and
    command are fractions of stroke; mode is RISING or FALLING.  Unless u_extreme changes, the command holds.
    """
    changed = True
    if mode == RISING and u > u_extreme:
        u_extreme = u
    elif mode == RISING and u < u_extreme - buffer:
        mode, u_extreme = FALLING, u
    elif mode == FALLING and u < u_extreme:
        u_extreme = u
    elif mode == FALLING and u > u_extreme + buffer:
        mode, u_extreme = RISING, u
    else:
        changed = False
    if changed:
        offset = estimate if mode == RISING else 0.0
        command = clip((1.0 - estimate) * u_extreme + offset, 0.0, 1.0)
    return command, mode, u_extreme
