"""A real headless browser for tests of pages; skipped where there is none, unless `REQUIRE_BROWSER` is set."""

import contextlib
import os
import shutil

import pytest


@contextlib.contextmanager
def browser(folder):
    """A selenium driver of Chromium that downloads into `folder`."""
    program, driver = (shutil.which(name) for name in ("chromium", "chromedriver"))
    if not (program and driver):
        if os.environ.get("REQUIRE_BROWSER"):
            pytest.fail("no browser: install Debian's chromium and chromium-driver")
        pytest.skip("no browser: install Debian's chromium and chromium-driver")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--hide-scrollbars",
        "--window-size=1250,1000",
        f"--user-data-dir={folder}/profile",
    ):
        options.add_argument(argument)
    options.add_experimental_option("prefs", {"download.default_directory": str(folder)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    opened = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield opened
    finally:
        opened.quit()


def complaints(opened):
    """What the console says: errors, warnings, refused loads."""
    return [entry["message"] for entry in opened.get_log("browser")]
