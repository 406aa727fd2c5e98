"""``fastcoil explore``: its server is for this machine alone; its page, in a real browser, follows what is moved."""

import http.client
import importlib.util
import re
import signal
import socket
import time
from urllib.parse import urlsplit

import pytest
from helpers import browsers
from helpers.commands import assert_command_refused, fastcoil

import fastcoil as fc

pytestmark = pytest.mark.skipif(importlib.util.find_spec("bokeh") is None, reason="bokeh is not installed")
HANDSHAKE = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": "bokeh",
}  # fmt: skip
ESTIMATE, TI = 1, 3
"""Sliders by their place on the page."""


@pytest.fixture(scope="module")
def program():
    with browsers.explore_page("lbnl") as process_and_address:
        yield process_and_address


def http_response(address, path="/", **headers):
    """(status, text) of what a program that sends these headers is given."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=30)
    try:
        connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        response = connection.getresponse()
        return response.status, "" if response.status == 101 else response.read().decode()
    finally:
        connection.close()


@pytest.mark.kernel
def test_it_is_there_for_this_machine_alone(program):
    _, address = program
    port = urlsplit(address).port
    status, page = http_response(address)
    assert status == 200
    for tag in ("src=", "href="):
        assert all(rest.startswith(('"/static/', '"data:')) for rest in page.split(tag)[1:])
    assert http_response(address, Host=f"somebody.example:{port}")[0] == 404
    assert http_response(address, "/ws", **HANDSHAKE, Origin="http://somebody.example")[0] == 404
    assert http_response(address, "/ws", **HANDSHAKE, Origin=f"http://localhost:{port + 1}")[0] == 404
    assert http_response(address, Origin="http://somebody.example")[0] == 404
    assert http_response(address, Origin=f"http://localhost:{port}")[0] == 200
    # a socket says where it comes from, and nobody else names a session
    assert http_response(address, "/ws", **HANDSHAKE)[0] == 404
    token = re.search('"token":"([^"]+)"', page)[1]
    own_handshake = HANDSHAKE | {"Sec-WebSocket-Protocol": f"bokeh, {token}"}
    assert http_response(address, "/ws", **own_handshake, Origin=f"http://localhost:{port}")[0] == 101
    for path in ("/?bokeh-session-id=mine", "/?kp=0.05&bokeh-token=mine", "/autoload.js", "/metadata"):
        assert http_response(address, path)[0] == 404, path
    assert http_response(address, Bokeh_Session_Id="mine")[0] == 404
    for taken_for in ("image", "iframe", "script", "empty"):
        assert http_response(address, Sec_Fetch_Dest=taken_for)[0] == 404
    # an address of this machine that is not the one served: one that listens everywhere would answer
    with pytest.raises(OSError):  # noqa: PT011 — refused, or not there at all
        socket.create_connection(("127.0.0.2", port), timeout=5)


@pytest.mark.kernel
@pytest.mark.parametrize(
    "path",
    ["%00", "a%0ab", "%1b[31m", "js/%62okeh.min.js", "..%2fx", "%2e%2e/x", "../x", "/x", "js/../x", ".x", "%ff", "js"],
)
def test_a_static_path_is_the_plain_name_of_a_file(program, path):
    """What is logged of others stands on stderr, which `test_sigterm_ends_it_as_ctrl_c_does` finds empty."""
    assert http_response(program[1], "/static/js/bokeh.min.js")[0] == 200
    assert http_response(program[1], f"/static/{path}")[0] in (403, 404)


@pytest.mark.kernel
def test_a_port_that_is_taken_is_refused_in_a_sentence(program):
    port = urlsplit(program[1]).port
    result = fastcoil("explore", "--no-browser", "--port", port)
    assert result.exit_code == 2
    assert result.output.startswith(f"fastcoil: port {port} cannot be used (Address already in use")
    assert f"give another one above 1023, such as --port {port + 1}\n" in result.output


@pytest.mark.kernel
def test_sigterm_ends_it_as_ctrl_c_does(program):
    process, _ = program
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (0, "Ended.\n", "")


def test_without_the_extra_there_is_the_command_that_installs_it(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: None if name == "bokeh" else find(name, *more))
    assert_command_refused("explore")


def test_what_cannot_be_explored_is_refused_before_a_page_is_there(tmp_path):
    assert_command_refused("explore", tmp_path / "mine.toml", "--no-browser")


# In a browser


@pytest.fixture(scope="module")
def browser_program():
    with browsers.explore_page() as process_and_address:
        yield process_and_address


@pytest.fixture(scope="module")
def driver():
    with browsers.chromium() as browser:
        yield browser


@pytest.fixture
def page(browser_program, driver):
    """The page, shown."""
    driver.get(browser_program[1])
    browsers.wait_for_page(driver)
    yield driver
    assert browser_program[0].poll() is not None or not browsers.console_problems(driver)


def press(driver, slider, times):
    """Move a slider up with the keyboard, and wait for the page."""
    from selenium.webdriver.common.keys import Keys

    before = browsers.wait_for_page(driver)
    browsers.find_all(driver, ".noUi-handle")[slider].send_keys(Keys.ARROW_RIGHT * times)
    browsers.wait_for_page(driver, before)


@pytest.mark.kernel
@pytest.mark.full
def test_the_page_shows_what_is_computed_and_a_key_moves_all_of_it(page):
    ds = fc.simulate(fc.Loop(), fc.paper_day(), traces=["T_sup", "opening"], trace_interval=5, n_jobs=1)
    assert browsers.element_text(page, "headline").startswith("This loop hunts: ± 0.51 K every 3.3 min.")
    assert browsers.figure_column(page, "traces", "T_sup") == ds.T_sup.values[-1441:].tolist()
    assert browsers.figure_column(page, "traces", "opening") == (100.0 * ds.opening.values[-1441:]).tolist()
    columns = ("traces", "T_sup"), ("cells", "value"), ("here", "x")
    traces, cells, ring = (browsers.figure_column(page, *column) for column in columns)
    assert (ring, browsers.figure_column(page, "here", "y")) == ([2], [7])  # Ti 8 s, Kp 0.03/K
    press(page, TI, 7)
    assert browsers.element_text(page, "headline").startswith("This loop does not hunt.  T_sup swings ± ")
    assert browsers.element_text(page, "advice").startswith("If the error matters: SIMC: kp ")
    assert browsers.element_text(page, "why").startswith("Why: hunting index 0.28; ")
    assert browsers.figure_column(page, "traces", "T_sup") != traces
    assert browsers.figure_column(page, "here", "x") != ring
    assert browsers.figure_column(page, "cells", "value") == cells
    press(page, ESTIMATE, 1)
    assert browsers.figure_column(page, "cells", "value") != cells


WATCH = """
window.seen = []
const shows = id => getComputedStyle(document.getElementById(id)).visibility === 'visible'
const source = (name, column) => Array.from(Bokeh.documents[0].get_model_by_name(name).get_array(column))
new MutationObserver(() => window.seen.push([
  document.body.dataset.phase, ['headline', 'advice', 'why', 'error'].map(shows),
  document.getElementById('headline').textContent, source('traces', 'T_sup').at(-1),
  source('hunting_indices', 'hunting_index'),
])).observe(document.body, {attributes: true, attributeFilter: ['data-phase']})
"""


@pytest.mark.kernel
@pytest.mark.full
def test_while_a_loop_is_not_explained_the_words_and_the_margin_of_the_one_before_are_hidden(page):
    before, old = browsers.element_text(page, "headline"), browsers.figure_column(page, "traces", "T_sup")[-1]
    page.execute_script(WATCH)
    press(page, TI, 7)
    changes = page.execute_script("return window.seen")
    assert any(phase == "words" for phase, *_ in changes)
    for phase, visible, headline, T_sup, hunting_index in changes:
        assert not (phase == "words" and visible[0])
        assert visible == ([False, False, False, True] if not visible[0] else [True, True, True, False])
        assert len(hunting_index) == visible[0]
        if visible[0]:
            assert (headline == before) == (T_sup == old)
    assert changes[-1][1] == [True, True, True, False]


@pytest.mark.kernel
@pytest.mark.full
def test_ctrl_c_ends_it_in_a_line_and_the_page_says_so(browser_program, page):
    process, _ = browser_program
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (0, "Ended.\n", "")
    end = time.monotonic() + 20
    while "has ended" not in browsers.element_text(page, "headline") and time.monotonic() < end:
        time.sleep(0.05)
    assert (
        browsers.element_text(page, "headline")
        == "The program behind this page has ended: start fastcoil explore again."
    )
