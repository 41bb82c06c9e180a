"""Photograph the pages: `python docs/photograph_pages.py FOLDER` writes docs/{view,report,play,inspect}.webp.

FOLDER keeps the synthetic world and its runs, so that a second call only takes the pictures. Needs Chromium, its driver
and selenium.
"""

import contextlib
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from selenium import webdriver
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.support.ui import WebDriverWait

DOCS = Path(__file__).parent
PROGRAM = Path(sys.executable).with_name("jrdb-avr")
RUNS = """[[run]]
method = ["monolithic", "chain-of-thought", "search-recognize", "react", "agent", "agent-no-world", "agent-passive"]
model = ["simulated:perfect", "simulated:realistic"]
"""


def call(*arguments):
    """Run a command of the program."""
    subprocess.run([PROGRAM, *map(str, arguments)], check=True)


@contextlib.contextmanager
def serving(*arguments):
    """Start a command that serves a page, and yield the address that it prints."""
    command = [PROGRAM, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield next(line.strip() for line in process.stdout if line.startswith("http://"))
        finally:
            process.kill()


def make_runs(folder):
    """Make the world and the runs that the pages show. Return the store."""
    store = folder / "store"
    if not (folder / "runs.toml").exists():
        call("demo", "--out", folder)
        (folder / "runs.toml").write_text(RUNS)
        call("runs", "remove", "react-simulated-perfect", "--store", store, "--yes")
        call("evaluate", "--store", store, "--matrix", folder / "runs.toml", "--per-template", "2", "--limit", "24")
        call("score", "--store", store)
    return store


class Camera:
    """A browser that writes pictures of its window."""

    def __init__(self):
        options = webdriver.ChromeOptions()
        options.binary_location = shutil.which("chromium")
        for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"):
            options.add_argument(argument)
        service = webdriver.ChromeService(shutil.which("chromedriver"))
        self.driver = webdriver.Chrome(options=options, service=service)

    def open(self, address, width, height):
        """Open a page in a window of this size, in pixels."""
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
        )
        self.driver.get(address)

    def find(self, selector, index=0):
        """Return an element as soon as the page has it."""
        WebDriverWait(self.driver, 60).until(lambda driver: len(driver.find_elements("css selector", selector)) > index)
        return self.driver.find_elements("css selector", selector)[index]

    def take(self, name, top, above=0):
        """Scroll to some pixels above an element, and write the window as a picture of the docs."""
        self.driver.execute_script("arguments[0].scrollIntoView(); scrollBy(0, -arguments[1])", top, above)
        ActionChains(self.driver).pause(2).perform()
        pixels = cv2.imdecode(np.frombuffer(self.driver.get_screenshot_as_png(), np.uint8), cv2.IMREAD_COLOR)
        cv2.imwrite(str(DOCS / f"{name}.webp"), pixels, [cv2.IMWRITE_WEBP_QUALITY, 80])


def main():
    """Make the runs if there are none, and take the four pictures."""
    folder = Path(sys.argv[1]).absolute()
    store = make_runs(folder)
    camera = Camera()

    call("report", "--store", store, "--html", folder / "report.html")
    camera.open((folder / "report.html").as_uri(), 1120, 1150)
    camera.take("report", camera.find("svg.square"), above=20)

    call("inspect", "--sample", "5", "--store", store, "--out", folder / "inspect.html")
    camera.open((folder / "inspect.html").as_uri(), 1250, 1330)
    camera.take("inspect", camera.find("body"))

    with serving("view", "--answers", "--store", store) as address:
        camera.open(address, 1120, 860)
        camera.find('a[href*="question?"][href*="run=agent-simulated-perfect"]').click()
        camera.take("view", camera.find("#stage"), above=400)

    shutil.rmtree(store / "runs" / "human-docs", ignore_errors=True)
    with serving("play", "--store", store, "--name", "docs", "--limit", "3") as address:
        camera.open(address, 960, 800)
        WebDriverWait(camera.driver, 60).until(lambda driver: camera.find("#question").text)
        camera.find("#scrub").send_keys(Keys.ARROW_RIGHT * 6)
        for turn in (-18, 36, -18):
            camera.find("#strip").send_keys((Keys.ARROW_LEFT if turn < 0 else Keys.ARROW_RIGHT) * abs(turn))
            camera.find("#look").click()
            ActionChains(camera.driver).pause(2).perform()
        drag = ActionChains(camera.driver).move_to_element(camera.find("#view")).move_by_offset(-61, -70)
        drag.click_and_hold().move_by_offset(40, 188).release().perform()
        camera.find("#fields input").click()
        camera.take("play", camera.find("#progress"))
    camera.driver.quit()


if __name__ == "__main__":
    main()
