"""Any sweep can grow, whatever was run of it before."""

import pytest
from helpers.processes import cut
from helpers.study_tables import fresh, run_shards, toml
from hypothesis import given, settings
from hypothesis import strategies as st

from fastcoil.study.file.spec import read_study
from fastcoil.study.run import execute

pytestmark = [pytest.mark.kernel, pytest.mark.timeout(120)]

AXES = {
    "backlash": [0.0, 0.01, 0.03, 0.08, 0.12],
    "estimate_ratio": [0.0, 0.4, 0.9, 1.3],
    "kp": [0.01, 0.02, 0.05],
    "noise_std": [0.0, 0.02],
}


@st.composite
def versions(draw):
    """A study and a larger version of it, as tables."""
    small, large = ({"loop": {}, "sweep": {}, "boundary": {"hours": 0.1}, "run": {"warm_up": 60}} for _ in range(2))
    for name, known in AXES.items():
        values = draw(st.lists(st.sampled_from(known), min_size=1, max_size=3, unique=True))
        kept = draw(st.lists(st.sampled_from(values), min_size=1, max_size=2, unique=True))
        for tables, chosen in ((small, kept), (large, values)):
            if len(chosen) == 1 and draw(st.booleans()):
                tables["loop"][name] = chosen[0]
            else:
                tables["sweep"][name] = chosen
    days = draw(st.permutations([1, 2, 3]))
    kept = draw(st.lists(st.sampled_from(days[:2]), min_size=1, unique=True))
    small["boundary"]["seed"], large["boundary"]["seed"] = kept, days[: draw(st.integers(2, 3))]
    small["run"]["replicates"] = draw(st.integers(1, 2))
    large["run"]["replicates"] = draw(st.integers(small["run"]["replicates"], 3))
    traces = draw(st.sampled_from([[], ["u"]]))
    for tables in (small, large):
        tables["run"] |= {"traces": traces, "trace_interval": 60}
    return small, large


@pytest.mark.parametrize("n", [3, pytest.param(200, marks=pytest.mark.full)])
def test_any_sweep_can_grow(tmp_path_factory, n):
    @settings(max_examples=n)
    @given(versions=versions(), n_shards=st.integers(0, 3))
    def grows(versions, n_shards):
        folder = tmp_path_factory.mktemp("grown")
        path = folder / "study.toml"
        with pytest.MonkeyPatch.context() as patch:
            cut(patch, 7, seed=n_shards)
            path.write_text(toml(versions[0]), encoding="utf-8")
            small = read_study(path)
            done = run_shards(small, folder / "out", n_shards if n_shards < len(small.plan.shards(1)) else None)
            path.write_text(toml(versions[1]), encoding="utf-8")
            large = read_study(path)
            finished = execute(large, folder / "out", extend=True)
            if large.text != small.text:
                assert finished.n_run == large.plan.n_scenarios - done
            assert finished.results.attrs["content_sha256"] == fresh(large, folder)

    grows()
