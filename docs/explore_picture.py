"""The picture of the page of ``fastcoil explore``: ``python docs/explore_picture.py`` writes docs/explore.png."""

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent / "tests"))

from helpers.browsers import chromium, explore_page, wait_for_page  # noqa: E402

with explore_page() as (_, address), chromium(1280, 800) as driver:
    driver.get(address)
    wait_for_page(driver)
    driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
    driver.save_screenshot(str(DOCS / "explore.png"))
