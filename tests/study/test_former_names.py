"""A metric that was called otherwise: its former name leads to that of today, and older results can be used."""

import pytest
from helpers.studies import PLAIN, run

import fastcoil as fc
from fastcoil.base.errors import InputError
from fastcoil.deliver.figures.study import bands
from fastcoil.study import maintenance
from fastcoil.study.folder import merge

NOW = "'hunting_amplitude' is not .*, it is called 'hunting_swing' now \\(peak to peak, as before"

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def older(tmp_path_factory):
    """A folder written when the metric was called ``hunting_amplitude``, and another was not known yet."""
    out = tmp_path_factory.mktemp("older") / "out"
    with pytest.MonkeyPatch.context() as patch:
        names = {"hunting_swing": "hunting_amplitude"}
        now = merge.unflatten
        patch.setattr(merge, "unflatten", lambda *given: now(*given).rename(names).drop_vars("share_off"))
        run(PLAIN, out)
    return out


def test_a_former_name_is_answered_with_that_of_today(older):
    ds = fc.open_study(older)
    by_design = ds.rename(backlash="sample", estimate_ratio="design").assign_coords(design=["A", "B"])
    by_design = by_design.reindex(design=["A", "B", "kp"])
    for ask in (
        lambda name: fc.compare(ds, baseline={"estimate_ratio": 0.0}, over="day", metrics=name),
        lambda name: bands(ds, "backlash", metrics=[name]),
        lambda name: fc.sobol_indices(by_design, metrics=name),
    ):
        with pytest.raises(InputError, match=NOW):
            ask("hunting_amplitude")
        with pytest.raises(InputError, match="did you mean 'hunting_period'"):
            ask("hunting_perod")
    with pytest.raises(InputError, match="'share_off' is not in the result$"):
        fc.compare(ds, baseline={"estimate_ratio": 0.0}, over="day", metrics="share_off")


def test_older_results_are_sound_and_read_under_the_name_of_today(older):
    ds = fc.open_study(older)
    assert "hunting_amplitude" not in ds
    fresh = fc.compare(ds, baseline={"estimate_ratio": 0.0}, over="day")
    assert float(abs(fresh["hunting_swing"].sel(statistic="value")).max()) > 0.0
    assert maintenance.verify(older) == []
    assert any("Finished" in line for line in maintenance.status(older))
    _, words = maintenance.rerun(older, {"backlash": "0.07", "estimate_ratio": "0.9", "day": "1"})
    assert "Equal to the study's result to the last bit." in words
