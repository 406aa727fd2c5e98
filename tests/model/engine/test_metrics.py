"""Every metric against plain NumPy on the traces of a run."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.model.metric_table import METRICS, TRACES

WARM_UP = 1000
N = 9400
SECONDS = np.arange(N)
OFF = ((SECONDS >= 3333) & (SECONDS < 3500)) | (SECONDS >= N - 30)
LOOPS = {
    "cooling": {"learning_step": 0.01, "learning_interval": 600.0, "noise_std": 0.02, "backlash_estimate": 0.03},
    "heating": {"action": "heating", "kp": 0.004, "ti": 30.0, "sample_time": 15.0, "C_w": 12.0, "stroke_time": 60.0},
    "open loop": {"air_march": "quasistatic"},
    "valve as it is": {"kp": 0.02, "ti": 30.0, "neutral_zone": 0.01, "slip_jump": 0.03, "leakage": 0.0},
}


class Run:
    """Traces of one loop as plain arrays, and what the metrics are made of."""

    def __init__(self, name):
        heating = name == "heating"
        boundary = fc.paper_day(hours=N / 3600, seed=3)
        series = {key: values[0] for key, values in boundary.series.items()} | {"enabled": np.where(OFF, 0, 1)}
        if heating:
            series |= {"T_w_in": 50.0, "T_a_in": 12.0, "T_set": boundary.series["T_set"][0] + 8.0}
        self.boundary = fc.Boundary(**series)
        self.series = {key: values[0] for key, values in self.boundary.series.items()}
        command = 0.5 + 0.4 * np.sin(SECONDS / 300.0) if name == "open loop" else None
        self.open_loop = command is not None
        self.loop = fc.Loop(**LOOPS[name])
        self.ds = fc.simulate(self.loop, self.boundary, command=command, traces=list(TRACES), warm_up=WARM_UP)
        self.counted = (SECONDS >= WARM_UP) & ~OFF
        self.error = self["T_sup"] - self.series["T_set"]
        starts = np.diff(self.series["enabled"]) > 0.0
        changes = np.flatnonzero(np.diff(self.series["T_set"]).astype(bool) | starts) + 1
        since = np.array([t - max([0, *changes[changes <= t]]) for t in SECONDS])
        self.settled = self.counted & (since >= 600)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.settled, [0]])))
        self.windows = [slice(a, b) for a, b in edges.reshape(-1, 2)]

    def __getitem__(self, name):
        return self.ds[name].values

    def blocks(self, length):
        """Whole blocks from the end of the warm-up that count throughout."""
        starts = range(WARM_UP, N - length + 1, length)
        return [slice(a, a + length) for a in starts if self.counted[a : a + length].all()]


@pytest.fixture(scope="module", params=LOOPS)
def run(request):
    return Run(request.param)


@pytest.mark.kernel
def test_the_run_is_not_trivial(run):
    assert len(run.windows) >= 4
    assert len(run.blocks(600)) == 11
    assert len(run.blocks(900)) == 8
    assert int(run.ds.status) == 0
    assert run.open_loop or float(run.ds.switch_frequency) > 0.0


def assert_metrics(run, **expected):
    for name, value in expected.items():
        assert float(run.ds[name]) == pytest.approx(value, rel=1e-12, abs=1e-12, nan_ok=True), name


@pytest.mark.kernel
def test_control_error(run):
    assert_metrics(
        run,
        rmse=np.sqrt(np.mean(run.error[run.counted] ** 2)),
        rmse_settled=np.sqrt(np.mean(run.error[run.settled] ** 2)),
        iae=np.abs(run.error[run.counted]).sum() / 3600.0,
        share_off=np.mean(np.abs(run.error[run.counted]) > 0.5),
    )


@pytest.mark.kernel
def test_hunting(run):
    crossings = sum(np.count_nonzero((run.error[w][:-1] < 0.0) & (run.error[w][1:] >= 0.0)) for w in run.windows)
    assert_metrics(
        run,
        hunting_swing=np.mean([np.ptp(run["T_sup"][w]) for w in run.windows]),
        hunting_period=run.settled.sum() / crossings if crossings >= 2 else np.nan,
    )
    assert 0.0 < float(run.ds.share_off) < 1.0


@pytest.mark.kernel
def test_travel_and_reversals(run):
    stem = np.diff(run["opening"], prepend=0.0)[run.counted]
    motor = np.diff(run["position"], prepend=0.0)[run.counted]
    signs = np.sign(stem[np.abs(stem) > 1e-9])
    assert_metrics(
        run,
        stem_travel=np.abs(stem).sum(),
        motor_travel=np.abs(motor).sum(),
        reversals=np.count_nonzero(np.diff(signs)),
    )


@pytest.mark.kernel
def test_switch_frequency(run):
    turned = np.diff(run["mode"], prepend=0 if run.open_loop else -1) != 0
    expected = np.nan if run.open_loop else np.mean([turned[block].sum() for block in run.blocks(600)])
    assert_metrics(run, switch_frequency=expected)


@pytest.mark.kernel
def test_estimate(run):
    recent = run.counted & (SECONDS >= N - 7200)
    settled = run["estimate"][recent].mean()
    assumes = run.loop["backlash_estimate"] > 0.0
    assert_metrics(
        run,
        estimate_final=run["estimate"][-1],
        estimate_settled=settled,
        size_error=settled - run.loop["backlash"] if assumes else np.nan,
    )


@pytest.mark.kernel
def test_learning_times(run):
    estimate, step = run["estimate"], run.loop["learning_step"]
    enough = run.loop["backlash"] - step / 2
    reached = confirmed = first_down = estimate_first_down = np.nan
    for t in range(600, N, 600) if step else ():
        down = estimate[t] < estimate[t - 1]
        reached = t if np.isnan(reached) and estimate[t] >= enough - 1e-12 else reached
        confirmed = t if np.isnan(confirmed) and down and not np.isnan(reached) else confirmed
        if np.isnan(first_down) and down:
            first_down, estimate_first_down = t, estimate[t]
    assert_metrics(
        run,
        learn_time_reached=reached,
        learn_time_confirmed=confirmed,
        learn_time_first_down=first_down,
        estimate_first_down=estimate_first_down,
    )


@pytest.mark.kernel
def test_power(run):
    sign = -1.0 if run.loop["action"] == "heating" else 1.0
    power = sign * run["m_w"] * 4.186 * (run["T_w"][-1] - run.series["T_w_in"])
    np.testing.assert_allclose(run["power"], power, rtol=1e-13)
    assert_metrics(
        run,
        coil_energy=power[run.counted].sum() / 3600.0,
        coil_peak_power=max(power[block].mean() for block in run.blocks(900)),
        water_volume=run["m_w"][run.counted].sum() / 1000.0,
    )
    assert power[run.counted].mean() > 0.0


@pytest.mark.kernel
def test_condensate(run):
    """The run ends with uncounted seconds, so every counted one has a successor to show what left the volumes."""
    W_out = run["W_a"][:, 1:]
    upstream = W_out if run.loop["air_march"] == "quasistatic" else run["W_a"][:, :-1]
    W_in = np.vstack([upstream[1:], run.series["W_a_in"][:-1]])
    rate = run.series["m_a"][:-1] * (W_in - W_out).sum(axis=0)
    assert_metrics(run, condensate=rate[run.counted[:-1]].sum())


@pytest.mark.kernel
def test_a_run_too_short_for_a_block_or_a_window_has_no_such_metric():
    ds = fc.simulate(fc.Loop(), fc.paper_day(hours=550 / 3600), warm_up=0)
    missing = {name for name in METRICS if np.isnan(ds[name])}
    learner = {"learn_time_reached", "learn_time_confirmed", "learn_time_first_down", "estimate_first_down"}
    estimators = learner | {"time_identified", "size_error", "half_periods", "half_period_spread"}
    assert missing == estimators | {
        "rmse_settled",
        "hunting_swing",
        "hunting_period",
        "hunts",
        "switch_frequency",
        "coil_peak_power",
    }


@pytest.mark.kernel
@pytest.mark.parametrize(("crossings", "period"), [(0, np.nan), (1, np.nan), (2, 1500.0), (3, 1000.0)])
def test_hunting_period_takes_two_crossings(crossings, period):
    """Open loop: T_sup is below the set-point, then above it, and so on."""
    command = np.resize(np.repeat([0.9, 0.1], 500), 3600)
    command[1000 * crossings + 800 :] = 0.9
    ds = fc.simulate(fc.Loop(), fc.constant_day(hours=1), command=command, warm_up=0)
    assert float(ds.hunting_period) == pytest.approx(period, nan_ok=True)


@pytest.mark.kernel
def test_metrics_of_a_run_that_never_counts_are_missing_or_zero():
    day = fc.constant_day(hours=1)
    never = fc.Boundary(**{name: values[0] for name, values in day.series.items()} | {"enabled": np.zeros(3600)})
    ds = fc.simulate(fc.Loop(), never)
    assert int(ds.status) == 0
    assert np.isnan(ds.rmse)
    assert [float(ds[name]) for name in ("iae", "stem_travel", "coil_energy", "water_volume", "condensate")] == [
        0.0
    ] * 5


@pytest.mark.kernel
def test_metrics_do_not_depend_on_the_traces():
    day = fc.paper_day(hours=0.5, seed=1)
    plain = fc.simulate(fc.Loop(), day, warm_up=100)
    traced = fc.simulate(fc.Loop(), day, warm_up=100, traces=list(TRACES), trace_interval=7)
    assert traced[list(METRICS)].identical(plain[list(METRICS)].assign_attrs(traced.attrs))
