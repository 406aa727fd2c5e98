"""A report in a real browser: nothing is fetched, nothing complains, nothing is wider than a phone or a sheet."""

import base64
import re

import pytest
from helpers.browsers import chromium, console_problems, requested_urls
from helpers.studies import PLAIN_STUDY, copy_run

import fastcoil as fc

pytestmark = [pytest.mark.kernel, pytest.mark.full]


def test_a_page_loads_nothing_and_fits_a_phone_a_screen_and_a_sheet(out):
    copy_run(PLAIN_STUDY, out)
    page = fc.report(out)
    with chromium() as browser:
        requested_urls(browser)  # what the browser asks for itself as it starts
        for width, mobile, media in ((390, True, "screen"), (1200, False, "screen"), (680, False, "print")):
            look = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": mobile}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", look)
            browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})
            browser.get(page.as_uri())
            assert browser.execute_script("return document.documentElement.scrollWidth") <= width
            image_script = "return [...document.images].map(i => i.complete && i.naturalWidth > 100)"
            assert browser.execute_script(image_script) == [True, True]
        requests = requested_urls(browser)
        assert page.as_uri() in requests
        assert not [url for url in requests if url.startswith(("http", "ws", "ftp"))]
        assert console_problems(browser) == []
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
        assert 2 <= len(re.findall(rb"/Type\s*/Page[^s]", base64.b64decode(browser.print_page()))) <= 6
