"""Programs with many threads, as servers, notebooks and graphical interfaces are: each ends with 0 if all went well.

``python -m helpers.many_threads PROGRAM FOLDER``
"""

import asyncio
import gc
import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np

import fastcoil as fc
from helpers.studies import TRACED_STUDY

TEXT = TRACED_STUDY.replace("seed = [1, 2, 3]", "seed = 1").replace('"mode"]', '"mode", "T_c"]').replace("= 50", "= 5")


def study_file(folder: Path) -> Path:
    """Write the file of a small study with traces, once."""
    path = folder / "small.toml"
    if not path.exists():
        path.write_text(TEXT, encoding="utf-8")
    return path


def read_study_folder(folder: Path, golden: str) -> float:
    """Open a study, and read parts of its traces and all of one."""
    ds = fc.open_study(folder)
    assert ds.attrs["content_sha256"] == golden
    part = ds["T_c"].isel(backlash=0, volume=[1, 3]).values
    assert part.shape[1] == 2, part.shape
    return float(ds["T_sup"].sum()) + float(np.sum(ds["mode"].values))


def run_in_threads(folder: Path, times: int = 2 if os.environ.get("FASTCOIL_FULL") else 1) -> None:
    """Run studies on three threads, each into its folder, while others read these and a finished one."""
    golden = fc.run_study(study_file(folder), folder / "one", n_jobs=1).attrs["content_sha256"]
    targets = [folder / f"out{k}" for k in range(3 * times)]
    is_done = threading.Event()

    def poll(k: int) -> int:
        n_finished = 0
        while not is_done.is_set():
            with suppress(fc.InputError):  # nothing is finished there yet
                ds = fc.open_study(targets[(k + n_finished) % len(targets)])
                n_finished += ds.attrs.get("content_sha256") == golden
            read_study_folder(folder / "one", golden)
            gc.collect()
        return n_finished

    with ThreadPoolExecutor(5) as pool:
        reader_futures = [pool.submit(poll, k) for k in range(2)]
        try:
            run_futures = [pool.submit(fc.run_study, study_file(folder), out, n_jobs=1) for out in targets]
            assert {run.result().attrs["content_sha256"] for run in run_futures} == {golden}
        finally:
            is_done.set()
        assert all(look.result() >= 0 for look in reader_futures)


def run_inside_an_event_loop(folder: Path, backend: str) -> None:
    """Run a study as in a notebook, inside a running event loop."""
    golden = fc.run_study(study_file(folder), folder / "one", n_jobs=1).attrs["content_sha256"]

    async def cell() -> str:
        ds = fc.run_study(study_file(folder), folder / "out", n_jobs=1, backend=backend)
        return str(ds.attrs["content_sha256"])

    assert asyncio.run(cell()) == golden


PROGRAMS = {
    "run": run_in_threads,
    **{f"{b} in a loop": lambda f, b=b: run_inside_an_event_loop(f, b) for b in ("threads", "loky")},
}

if __name__ == "__main__":
    PROGRAMS[sys.argv[1]](Path(sys.argv[2]))
