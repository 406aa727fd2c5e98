"""A report in a real browser: nothing is fetched, nothing complains, nothing is wider than a phone or a sheet."""

import base64
import re
import shutil

import pytest
from helpers.studies import PLAIN, copied

import fastcoil as fc

pytestmark = [pytest.mark.kernel, pytest.mark.full]

QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update",
)  # fmt: skip


@pytest.fixture
def browser(tmp_path):
    webdriver = pytest.importorskip("selenium.webdriver")
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("no chromium with chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in (*QUIET, f"--user-data-dir={tmp_path / 'profile'}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    opened = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield opened
    opened.quit()


def test_a_page_loads_nothing_and_fits_a_phone_a_screen_and_a_sheet(browser, out):
    copied(PLAIN, out)
    page = fc.report(out)
    browser.get("about:blank")
    browser.get_log("performance")  # what the browser asks for itself as it starts
    for width, mobile, media in ((390, True, "screen"), (1200, False, "screen"), (680, False, "print")):
        look = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": mobile}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", look)
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})
        browser.get(page.as_uri())
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width
        shown = "return [...document.images].map(i => i.complete && i.naturalWidth > 100)"
        assert browser.execute_script(shown) == [True, True]
    asked = re.findall(r'"url\\?":\\?"(.*?)\\?"', str(browser.get_log("performance")))
    assert page.as_uri() in asked
    assert not [url for url in asked if url.startswith(("http", "ws", "ftp"))]
    assert browser.get_log("browser") == []
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    sheets = re.findall(rb"/Type\s*/Page[^s]", base64.b64decode(browser.print_page()))
    assert 2 <= len(sheets) <= 6
