"""The valve test as a script: wait, ramp until the temperature has passed the set-point, wait, turn."""


class EndOfTest(Exception):
    """End of the test; the argument is the reason, empty after the full time."""


def air_changes(air_flows, sample_time):
    """Relative changes of the air flow, sample by sample, from a mean that follows it in five minutes."""
    mean = air_flows[0]
    for flow in air_flows:
        mean += (flow - mean) * sample_time / (300.0 + sample_time)
        yield flow / mean - 1.0


def wait_for_calm_air(air_flows, sample_time, request):
    """Sample at which a test that is requested at ``request`` begins; None where it is refused after an hour."""
    calm_seconds = 300.0
    for k, change in enumerate(air_changes(air_flows, sample_time)):
        calm_seconds = calm_seconds + sample_time if abs(change) <= 0.08 else 0.0
        if k >= request and calm_seconds >= 300.0:
            return k
        if (k - request + 1) * sample_time > 3600.0:
            return None
    raise AssertionError("the record ends while the test waits")


def valve_test(errors, command, sample_time, *, minutes, rate, threshold, settle, hold, excursion, air_flows=None):
    """Run a test that begins at the first of ``errors``, K; return its commands, and why it ended early.

    errors: one a sample, positive where the valve should open.  command: held at first.
    """
    changes = [0.0] * len(errors) if air_flows is None else air_changes(air_flows, sample_time)
    remaining, commands = iter(list(zip(errors, changes, strict=False))), []
    first_ramp = True

    def next_error():
        """Return the next error, or end the test."""
        if len(commands) * sample_time >= 60 * minutes:
            raise EndOfTest("")
        e, change = next(remaining, (None, 0.0))
        if e is None:
            raise EndOfTest("no more errors")
        is_by_air = change > 0.05 if e > 0 else change < -0.05
        if abs(e) > excursion * (2 if first_ramp or is_by_air else 1):
            raise EndOfTest("excursion")
        return e

    try:
        settling_errors = []
        while True:
            e = next_error()
            if not settling_errors and ((command == 0.0 and e < 0) or (command == 1.0 and e > 0)):
                raise EndOfTest("end_of_stroke")
            settling_errors.append(e)
            if (len(settling_errors) - 1) * sample_time >= settle:
                break
            commands.append(command)
        early_samples = [k for k in range(len(settling_errors)) if k * sample_time <= settle - 60]
        last_minute = settling_errors[(early_samples[-1] if early_samples else 0) :]
        if max(last_minute) - min(last_minute) > 0.3:
            raise EndOfTest("swing")
        direction, first_rate = (1 if e > 0 else -1), rate
        while True:
            ramp_start = command
            while True:
                command = min(max(command + direction * rate * sample_time, 0.0), 1.0)
                commands.append(command)
                e = next_error()
                at_end = command == (1.0 if direction > 0 else 0.0)
                if at_end and direction * e > 0:
                    raise EndOfTest("end_of_stroke")
                if at_end or direction * e < -threshold or abs(command - ramp_start) >= 0.3:
                    break
            commands.append(command)
            first_ramp, hold_errors = False, [e]
            while True:
                hold_errors.append(next_error())
                if (len(hold_errors) - 1) * sample_time >= hold:
                    break
                commands.append(command)
            overshoot = max(-direction * e for e in hold_errors) - threshold
            target = min(0.5, excursion / 3)
            rate *= target / overshoot if overshoot > target / 2 else 2.0
            rate = min(max(rate, 0.2 * first_rate), 4.0 * first_rate)
            direction = -direction
    except EndOfTest as end:
        return commands, str(end)
