"""The page of ``fastcoil explore`` in a real browser: it follows what is moved, and asks nobody else for anything."""

import functools
import os
import signal
import threading
import time
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from helpers import browsers
from helpers.browsers import chromium, data_of, deep, exploring, settled, text_of, why_no_browser

import fastcoil as fc

pytestmark = [pytest.mark.kernel, pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())]
ESTIMATE, TI = 1, 3
"""Sliders by their place on the page."""


@pytest.fixture(scope="module")
def program():
    with exploring() as found:
        yield found


@pytest.fixture(scope="module")
def driver():
    with chromium() as found:
        yield found


@pytest.fixture
def page(program, driver):
    """The page, shown."""
    driver.get(program[1])
    settled(driver)
    yield driver
    assert program[0].poll() is not None or not browsers.mistakes_of(driver)


def press(driver, slider, times):
    """Move a slider up with the keyboard, and wait for the page."""
    from selenium.webdriver.common.keys import Keys

    before = settled(driver)
    deep(driver, ".noUi-handle")[slider].send_keys(Keys.ARROW_RIGHT * times)
    settled(driver, before)


def test_the_page_shows_what_is_computed_and_a_key_moves_all_of_it(page):
    ds = fc.simulate(fc.Loop(), fc.paper_day(), traces=["T_sup", "opening"], trace_interval=5, n_jobs=1)
    assert text_of(page, "headline").startswith("This loop will hunt: about 0.9")
    assert data_of(page, "traces", "T_sup") == ds.T_sup.values[-1441:].tolist()
    assert data_of(page, "traces", "opening") == (100.0 * ds.opening.values[-1441:]).tolist()
    traces, cells, ring = data_of(page, "traces", "T_sup"), data_of(page, "cells", "value"), data_of(page, "here", "x")
    assert (ring, data_of(page, "here", "y")) == ([2], [7])  # Ti 8 s, Kp 0.03/K
    press(page, TI, 7)
    assert text_of(page, "headline").startswith("This loop will not hunt")
    assert text_of(page, "advice").startswith("If the error matters: SIMC: kp ")
    assert text_of(page, "why").startswith("Why: margin 0.28; ")
    assert "?loop=paper_like&ti=40" in page.current_url
    assert data_of(page, "traces", "T_sup") != traces
    assert data_of(page, "here", "x") != ring
    assert data_of(page, "cells", "value") == cells
    press(page, ESTIMATE, 1)
    assert data_of(page, "cells", "value") != cells


FOREIGN = """<title>foreign</title>
<img src="{page}?kp=0.061"><script src="{page}autoload.js?bokeh-autoload-element=x"></script>
<iframe src="{page}?kp=0.062"></iframe>
<script>
  window.said = []
  fetch("{page}?kp=0.063", {{mode: "no-cors"}})
  const socket = new WebSocket("{page}ws".replace("http", "ws"), ["bokeh", "x"])
  socket.onopen = () => window.said.push("open")
  socket.onerror = () => window.said.push("refused")
</script>"""


def test_a_foreign_page_makes_it_compute_nothing(program, page, tmp_path):
    (tmp_path / "index.html").write_text(FOREIGN.format(page=program[1]))
    handler = functools.partial(SimpleHTTPRequestHandler, directory=tmp_path)
    handler.log_message = lambda *_: None
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as foreign:
        threading.Thread(target=foreign.serve_forever, daemon=True).start()
        before = cpu_seconds(program[0].pid)
        page.get(f"http://localhost:{foreign.server_address[1]}/")
        time.sleep(1.0)
        assert page.execute_script("return window.said") == ["refused"]
        assert cpu_seconds(program[0].pid) - before < 0.2  # a page alone takes more
        foreign.shutdown()
    browsers.mistakes_of(page)  # those of the foreign page


def cpu_seconds(pid):
    """Time of the processor that a process has taken."""
    times = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(times[11]) + int(times[12])) / os.sysconf("SC_CLK_TCK")


def test_ctrl_c_ends_it_in_a_line_and_the_page_says_so(program, page):
    process, _ = program
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (0, "Ended.\n", "")
    end = time.monotonic() + 20
    while "has ended" not in text_of(page, "headline") and time.monotonic() < end:
        time.sleep(0.05)
    assert text_of(page, "headline") == "The program behind this page has ended: start fastcoil explore again."
