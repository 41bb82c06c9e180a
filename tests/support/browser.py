"""A real browser, and requests to the local server."""

import contextlib
import http.client
import os
import shutil
import threading
from urllib.parse import urlsplit

import pytest

from jrdb_avr.engine.local_server import LocalServer


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


@contextlib.contextmanager
def serving(respond):
    with LocalServer(respond) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def fetch(server, path="", *, method="GET", body=None, target=None, headers=()):
    """(status, text) of a request for a path behind the token, or for a whole target; headers replace the usual."""
    url = urlsplit(server.url)
    connection = http.client.HTTPConnection(url.hostname, url.port, timeout=300)
    try:
        connection.putrequest(method, target or url.path + path, skip_host=True)
        named = dict(headers)
        for name, value in ({"Host": url.netloc} | named).items():
            for own in value if isinstance(value, list) else [value]:
                connection.putheader(name, own)
        if body is not None and "Content-Length" not in named:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)
        response = connection.getresponse()
        return response.status, response.read().decode("utf-8", "replace")
    finally:
        connection.close()
