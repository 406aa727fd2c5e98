"""The valve test as a script: wait, ramp until the temperature has passed the set-point, wait, turn."""


class Ended(Exception):
    """The test is over; the argument says why, empty at its end."""


def valve_test(errors, command, sample_time, *, minutes, rate, threshold, settle, hold, excursion):
    """Commands of a test that begins at the first of ``errors``, K, and why it ended early.

    errors: one a sample, positive where the valve should open.  command: that is held first.
    """
    seen, found = iter(list(errors)), []
    first_ramp = True

    def look():
        """The next error, unless the test is over."""
        if len(found) * sample_time >= 60 * minutes:
            raise Ended("")
        e = next(seen, None)
        if e is None:
            raise Ended("no more errors")
        if abs(e) > excursion * (2 if first_ramp else 1):
            raise Ended("excursion")
        return e

    try:
        waited = []
        while True:
            e = look()
            if not waited and ((command == 0.0 and e < 0) or (command == 1.0 and e > 0)):
                raise Ended("end_of_stroke")
            waited.append(e)
            if (len(waited) - 1) * sample_time >= settle:
                break
            found.append(command)
        last = [k for k in range(len(waited)) if k * sample_time <= settle - 60]
        calm = waited[(last[-1] if last else 0) :]
        if max(calm) - min(calm) > 0.3:
            raise Ended("swing")
        direction, first_rate = (1 if e > 0 else -1), rate
        while True:
            began = command
            while True:
                command = min(max(command + direction * rate * sample_time, 0.0), 1.0)
                found.append(command)
                e = look()
                at_end = command == (1.0 if direction > 0 else 0.0)
                if at_end and direction * e > 0:
                    raise Ended("end_of_stroke")
                if at_end or direction * e < -threshold or abs(command - began) >= 0.3:
                    break
            found.append(command)
            first_ramp, held = False, [e]
            while True:
                held.append(look())
                if (len(held) - 1) * sample_time >= hold:
                    break
                found.append(command)
            ran_on = max(-direction * e for e in held) - threshold
            wished = min(0.5, excursion / 3)
            rate = min(
                max(rate * (wished / ran_on if ran_on > wished / 2 else 2.0), 0.2 * first_rate), 4.0 * first_rate
            )
            direction = -direction
    except Ended as end:
        return found, str(end)
