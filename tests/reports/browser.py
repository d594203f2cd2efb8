"""Headless Chromium with a page from the disk."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest


@contextmanager
def opened(file: Path) -> Iterator[Any]:
    """Yield the browser with the page, when its script has run; skip the test if there is no browser."""
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not binary or not driver:
        pytest.skip("Chromium and chromedriver are not installed")
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    flags = ("headless=new", "no-sandbox", "use-angle=swiftshader", "enable-unsafe-swiftshader")
    for flag in (*flags, "disable-background-networking", "window-size=900,700"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        browser.get(file.as_uri())
        wait(browser, "return document.documentElement.dataset.ready")
        yield browser
    finally:
        browser.quit()


def wait(browser: Any, script: str) -> Any:
    """Return the value of a script as soon as it is not null, false or zero, within a minute."""
    for _ in range(600):
        if value := browser.execute_script(script):
            return value
        time.sleep(0.1)
    raise AssertionError(f"never true: {script}")
