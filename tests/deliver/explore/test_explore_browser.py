"""The page of ``fastcoil explore`` in a real browser: it follows what is moved, and asks nobody else for anything."""

import functools
import os
import signal
import threading
import time
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

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


def click(driver, title):
    before = settled(driver)
    (button,) = [each for each in deep(driver, "button") if each.text == title]
    button.click()
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


def test_a_story_the_reset_and_links_right_and_wrong(program, page):
    click(page, "Estimate too large")
    assert "its motor chatters" in text_of(page, "headline")
    link = page.current_url
    click(page, "Reset")
    assert text_of(page, "headline").startswith("This loop will hunt")
    assert page.current_url == program[1] + "?loop=paper_like"
    page.get(link)
    settled(page)
    assert "its motor chatters" in text_of(page, "headline")
    page.get(program[1] + "?loop=paper_like&backlash=300&ti=40")
    settled(page)
    said = text_of(page, "problems")
    assert said == "'backlash = 300': no setting of this page, or beyond its bounds; the rest of the link is shown."
    assert text_of(page, "headline").startswith("This loop will not hunt")


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


def test_readers_do_not_disturb_each_other(program, page):
    first = page.current_window_handle
    page.switch_to.new_window("tab")
    page.get(program[1])
    settled(page)
    click(page, "A good valve")
    assert text_of(page, "compared") == "The valve has no gap."
    page.close()
    page.switch_to.window(first)
    assert text_of(page, "headline").startswith("This loop will hunt")
    click(page, "Slower instead")
    assert text_of(page, "headline").startswith("This loop will not hunt")


def test_a_click_on_the_map_goes_there_and_nothing_is_asked_of_anybody_else(page):
    from selenium.webdriver.common.actions.action_builder import ActionBuilder

    before = settled(page)
    x, y = page.execute_script(
        "const view = Bokeh.index.find_one_by_id(Bokeh.documents[0].get_model_by_name('map').id);"
        "const at = view.el.getBoundingClientRect();"
        "return [at.x + view.frame.x_scale.compute(9), at.y + view.frame.y_scale.compute(8)]"
    )
    actions = ActionBuilder(page)
    actions.pointer_action.move_to_location(round(x), round(y)).click()
    actions.perform()
    settled(page, before)
    assert "?loop=paper_like&kp=0.04&ti=100" in page.current_url
    asked = [urlsplit(address) for address in browsers.requests_of(page)]
    assert {one.hostname for one in asked if one.scheme in ("http", "https", "ws", "wss")} == {"localhost"}


def test_ctrl_c_ends_it_in_a_line_and_the_page_says_so(program, page):
    process, _ = program
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (0, "Ended.\n", "")
    end = time.monotonic() + 20
    while "has ended" not in text_of(page, "headline") and time.monotonic() < end:
        time.sleep(0.05)
    assert text_of(page, "headline") == "The program behind this page has ended: start fastcoil explore again."
