"""A browser without a window, and the page of ``fastcoil explore`` in it."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager

import pytest

BROWSER_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-extensions",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
)  # fmt: skip
_MAX_WAIT_S = 60.0


def why_no_browser():
    """Return why there is no browser to test with; empty if there is one."""
    try:
        import bokeh  # noqa: F401
        import selenium  # noqa: F401
    except ImportError as error:
        return f"{error.name} is not installed"
    missing = [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]
    return f"no {' and no '.join(missing)}" if missing else ""


@contextmanager
def chromium(width=1280, height=800):
    """Start a driver of Chromium that records all requests and the console of the page."""
    if why_no_browser():
        pytest.skip(why_no_browser())
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for word in (*BROWSER_OPTIONS, f"--user-data-dir={profile}", f"--window-size={width},{height}"):
            options.add_argument(word)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        service = webdriver.ChromeService(shutil.which("chromedriver"))
        driver = webdriver.Chrome(options=options, service=service)
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        try:
            yield driver
        finally:
            driver.quit()


@contextmanager
def explore_page(*words):
    """Start a process of ``fastcoil explore``; yield it and the address of its page."""
    command = [sys.executable, "-u", "-m", "fastcoil", "explore", *words, "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        assert line.startswith("Page: http://localhost:"), line + process.stderr.read()
        yield process, line.split()[1]
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def wait_for_page(driver, views_before=0):
    """Wait until the page shows its settings after ``views_before`` views; return the number of views."""
    end = time.monotonic() + _MAX_WAIT_S
    while time.monotonic() < end:
        phase, turn = driver.execute_script("return [document.body.dataset.phase, document.body.dataset.turn]")
        if phase == "refused" or (phase == "" and int(turn or 0) > views_before):
            return int(turn or 0)
        time.sleep(0.02)
    raise AssertionError(f"the page is not ready: {phase!r}, {turn!r}")


def element_text(driver, name):
    """Return the text of an element of the page."""
    return driver.execute_script("return document.getElementById(arguments[0]).textContent", name)


def figure_column(driver, source, column):
    """Return a column of the data of a figure."""
    code = "return Array.from(Bokeh.documents[0].get_model_by_name(arguments[0]).get_array(arguments[1]))"
    return driver.execute_script(code, source, column)


def find_all(driver, selector):
    """Return all elements of the page that match, also in shadow trees, in the order of the page."""
    code = """
    const found = []
    const walk = root => {
      for (const each of root.querySelectorAll('*')) {
        if (each.matches(arguments[0])) found.push(each)
        if (each.shadowRoot) walk(each.shadowRoot)
      }
    }
    walk(document)
    return found"""
    return driver.execute_script(code, selector)


def requested_urls(driver):
    """Return the addresses that the browser requested."""
    messages = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    sent = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    return sent + [m["params"]["url"] for m in messages if m["method"] == "Network.webSocketCreated"]


def console_problems(driver):
    """Return errors and warnings on the console of the page."""
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
