"""The study of hunting: the formula that it finds, its margins by hand, and its tables."""

import control
import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies import common as report
from studies.hunting import backlash as hunting_backlash
from studies.hunting import hunting
from studies.hunting import loops as hunting_loops
from studies.hunting import noise as hunting_noise


@pytest.fixture(scope="module")
def loops():
    """Loops that nobody simulated, which hunt by a formula of the test's own: (sample, day)."""
    rng = np.random.default_rng(3)
    shape, dims = (300, 4), ("sample", "day")

    def drawn(low, high):
        return dims, np.exp(rng.uniform(np.log(low), np.log(high), shape))

    ds = xr.Dataset(
        {"kp": drawn(0.005, 0.2), "ti": drawn(4, 300), "K": drawn(5, 60), "T": drawn(20, 300), "theta": drawn(3, 60)},
        coords={"day": ["wet cooling 0", "wet cooling 1", "heating 0", "heating 1"]},
    )
    ds["hunts"] = ((ds.kp * ds.K) ** 0.8 * (ds["T"] + 2.0 * ds.theta) > 5.0 * ds.ti).astype(float)
    ds["backlash"] = ("sample",), rng.choice([0.0, 0.05], 300)
    ds["reachable"] = dims, rng.uniform(size=shape) < 0.9
    ds["hunting_index"] = dims, rng.uniform(0.1, 2.0, shape)
    ds = ds.assign(overshoot=ds.hunting_index, predicted=(ds.hunting_index > 1.0).astype(float))
    return ds.assign(gain_margin=1.0 / ds.hunting_index, phase_margin=90.0 - 30.0 * ds.hunting_index)


def test_the_choice_finds_the_formula_by_which_loops_hunt(loops):
    rules, (power, delays) = hunting_loops.choose_rules(loops)
    assert (power, delays) == (0.8, 2.0)
    formula = rules[1]
    assert formula.limit == pytest.approx(5.0, rel=0.03)
    assert formula.safe <= formula.limit
    at = loops.isel(sample=[7], day=[1])
    by_hand = (float(at.kp[0, 0]) * float(at.K[0, 0])) ** 0.8 * (float(at["T"][0, 0]) + 2 * float(at.theta[0, 0]))
    assert float(formula.indicator(at)[0, 0]) == pytest.approx(by_hand / float(at.ti[0, 0]))


def test_the_describing_function_of_a_gap_is_that_of_another_library():
    library_gap = control.friction_backlash_nonlinearity(0.07)
    for depth in (0.02, 0.3, 0.6, 0.95):
        lag, size = hunting_loops.gap_describing_function(np.array(depth))
        value = library_gap.describing_function(0.5 * 0.07 / depth)
        assert size == pytest.approx(abs(value))
        assert lag == pytest.approx(-np.angle(value))


@pytest.mark.kernel
def test_the_margin_is_that_of_a_first_order_loop_by_hand_and_proportional_to_kp():
    """With a slow first-order sensor the coil is fast; what is left is K, a lag, half a sample, and an integral."""
    loop = fc.Loop.preset("lbnl").assign(
        sensor_time_constant=2000.0, sample_time=1.0, kp=[0.5, 1.0], ti=100.0, backlash=0.07, C_w=8.8, C_c=8.0
    )
    day = fc.constant_day(hours=1)
    plant = hunting_loops.loop_properties(loop, day)
    K, w = float(plant.K[0]), np.geomspace(1e-4, 1.0, 4000)
    s, coil = 1j * w, fc.linearise(loop.assign(sensor_time_constant=0.0, kp=0.5), day)
    L = 0.5 * (1.0 + 1.0 / (100.0 * s)) * K / ((1.0 + 2000.0 * s) * (1.0 + float(coil.lag) * s))
    L = L * np.exp(-s * (float(coil.delay) + 0.5))
    phase_left = np.pi + np.unwrap(np.angle(L))
    N = control.friction_backlash_nonlinearity(1.0)
    values = np.array([N.describing_function(a) for a in np.geomspace(0.501, 50.0, 80)])
    is_inside = (phase_left > 0.0) & (phase_left < 0.5 * np.pi)
    lag = -np.angle(values)[::-1]
    by_hand = np.max(np.abs(L[is_inside]) * np.interp(phase_left[is_inside], lag, np.abs(values)[::-1]))
    assert float(plant.hunting_index[0]) == pytest.approx(by_hand, rel=0.1)
    assert float(plant.hunting_index[1]) == pytest.approx(2.0 * float(plant.hunting_index[0]))
    assert float(plant["T"][0]) == pytest.approx(2000.0, rel=0.05)


@pytest.mark.full
@pytest.mark.kernel
def test_the_command_writes_every_table_and_figure(read_table, tmp_path, monkeypatch):
    study = tmp_path / "hunting.toml"
    study.write_text(hunting.STUDY.read_text().replace(", 34]", ", 6]"))
    monkeypatch.setattr(hunting, "STUDY", study)
    monkeypatch.setattr(hunting, "results", lambda name: fc.run_study(study, tmp_path / name))
    monkeypatch.setattr(hunting_backlash, "CHANGES", {"as it is: x": {}, "ti × 2": {"ti": 2.0}})
    hunting.main(8, 2)
    names = sorted(path.stem for path in report.OUTPUT_FOLDER.glob("*/tables/*.md"))
    assert names == sorted(path.stem for path in (report.STUDIES / "hunting" / "tables").glob("hunting*.md"))
    assert all(len(read_table(name)[1]) > 1 for name in names)
    for name in ("hunting", "hunting_population"):
        assert (tmp_path / "studies" / "hunting" / f"{name}.png").stat().st_size > 20_000


def test_the_tables_of_noise_count_who_hunts_although_the_index_is_low(loops, read_table, monkeypatch):
    """Loops that hunt above an index which noise lowers by 20 per kelvin, and never without a gap."""
    levels = list(hunting_noise.NOISE_LEVELS)
    noise = xr.DataArray(levels, dims="noise", coords={"noise": levels})
    index = (loops.kp * loops.K) ** 0.7 * (loops["T"] + 2.0 * loops.theta) / loops.ti
    with_gap = (index > 5.0 - 20.0 * noise).astype(float)
    hunts = xr.concat([with_gap, 0.0 * with_gap], xr.DataArray(["with", "without"], dims="gap", name="gap"))
    ds = loops.assign(hunts=hunts, sample_time=("sample", np.resize(hunting_noise.SAMPLE_TIMES, 300)))
    population = ds.assign(predicted=ds.predicted.expand_dims(gap=ds.gap))
    monkeypatch.setattr(hunting_noise, "population", lambda *_: population)
    hunting_noise.main()
    is_usable = ds.reachable.values
    is_between = is_usable & (index >= 4.0).values & (index < 5.0).values
    (row,) = (row for row in read_table("hunting_noise")[1] if row[:2] == ["with", "4 to 5"])
    assert [row[2], row[3].split()[0], row[-1].split()[0]] == [f"{is_between.sum()}", "0.0", "100.0"]
    obeys = is_usable & (index <= 5.0).values
    share = 100 * (obeys & (index > 4.0).values).sum() / obeys.sum()
    limits = read_table("hunting_noise_limits")[1]
    (row,) = (row for row in limits if row[0].endswith("/ 5"))
    assert [row[2].split()[0], row[-2].split()[0]] == ["0.0", f"{share:.1f}"]
    assert all(row[-2].startswith("0.0") for row in limits if row[0].endswith(("/ 4", "/ 3")))
    assert all(row[2].startswith("0 %") for row in read_table("hunting_noise_predicted")[1] if row[0] == "without")
