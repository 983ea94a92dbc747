"""A headless Chromium that uses the page of ``bayeq app`` as a person would."""

from __future__ import annotations

import shutil
import time
from contextlib import contextmanager

from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

__all__ = ["Page", "browser", "missing_browser"]

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
WAIT = 240.0


def missing_browser():
    """Why there is no browser to use; empty where there is one."""
    if not any(map(shutil.which, BROWSERS)):
        return "there is no Chromium here to use the page with"
    return "" if shutil.which("chromedriver") else "there is no chromedriver here to use Chromium with"


@contextmanager
def browser(folder, width=1280, height=1200):
    """A headless Chromium that downloads into a folder and logs its console and its requests."""
    options = webdriver.ChromeOptions()
    options.binary_location = next(filter(None, map(shutil.which, BROWSERS)))
    for flag in (
        "headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", f"window-size={width},{height}",
        f"user-data-dir={folder / 'profile'}", "hide-scrollbars", "disable-background-networking", "no-first-run",
    ):  # fmt: skip
        options.add_argument(f"--{flag}")
    options.add_experimental_option("prefs", {"download.default_directory": str(folder)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    driver.get("about:blank")
    for log in ("browser", "performance"):  # of the browser's own first page
        driver.get_log(log)
    try:
        yield driver
    finally:
        driver.quit()


class Page:
    """What a person does on the page, and what is seen."""

    def __init__(self, driver, address, folder=None):
        self.driver, self.folder = driver, folder
        driver.get(address)
        self.wait(lambda: driver.find_elements(By.CSS_SELECTOR, "input[type=file]"), "the page is there")

    def wait(self, condition, what, seconds=WAIT):
        """The value of a condition, once it is true."""
        return WebDriverWait(self.driver, seconds, 0.2, ignored_exceptions=(Exception,)).until(
            lambda _: condition(), what
        )

    @property
    def text(self):
        return self.driver.find_element(By.TAG_NAME, "main").text

    def drop(self, file):
        """Drop a file onto the page."""
        self.wait(lambda: self.driver.find_element(By.CSS_SELECTOR, "input[type=file]"), "a place to drop").send_keys(
            str(file)
        )

    def field(self, label):
        """The field of a label."""
        (found,) = self.driver.find_elements(By.CSS_SELECTOR, f'input[aria-label^="{label}"]')
        return found

    def write(self, label, text):
        """Replace the text of a field."""
        field = self.field(label)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(Keys.DELETE)
        field.send_keys(text)

    def choose(self, label, value):
        """Choose a value in a list."""
        self.field(label).find_element(By.XPATH, "./ancestor::label").click()
        items = "//div[contains(@class, 'q-menu')]//div[contains(@class, 'q-item')]"
        item = self.wait(lambda: self.driver.find_element(By.XPATH, f"{items}[normalize-space()='{value}']"), value)
        item.click()
        self.wait(lambda: not self.driver.find_elements(By.CSS_SELECTOR, ".q-menu"), "the list closes")

    def button(self, words):
        return self.driver.find_element(By.XPATH, f"//button[normalize-space()='{words}']")

    def press(self, words):
        self.wait(lambda: self.button(words).is_enabled(), f"{words} can be pressed")
        self.button(words).click()

    def error(self):
        """The error that is shown, empty if none is."""
        return " ".join(one.text for one in self.driver.find_elements(By.CSS_SELECTOR, "[role=alert]"))

    def result(self, number):
        """The text of the report of a run."""
        frame = self.wait(
            lambda: self.driver.find_element(By.CSS_SELECTOR, f'iframe[src="/report.html?run={number}"]'), "a result"
        )
        self.driver.switch_to.frame(frame)
        try:
            self.wait(lambda: "Made by bayeq" in self.driver.find_element(By.TAG_NAME, "body").text, "the report")
            return self.driver.find_element(By.TAG_NAME, "body").text
        finally:
            self.driver.switch_to.default_content()

    def drawn(self, number):
        """Whether the live pictures of a run's report are there."""
        script = (
            "const page = document.querySelector(arguments[0]).contentDocument;"
            "return page.documentElement.dataset.drawn == page.querySelectorAll('script.plot').length"
        )
        return self.driver.execute_script(script, f'iframe[src="/report.html?run={number}"]')

    def top_of(self, title):
        """Where a heading is [pixels from the top]."""
        heading = self.driver.find_element(By.XPATH, f"//h2[contains(., '{title}')]")
        return int(self.driver.execute_script("return arguments[0].getBoundingClientRect().top + scrollY", heading))

    def download(self, words):
        """The file behind a link, once it is there."""
        link = self.driver.find_element(By.LINK_TEXT, words)
        file = self.folder / link.get_attribute("download")
        link.click()
        self.wait(file.exists, f"{file.name} is there")
        return file

    def screenshot(self, path, width, scale=1):
        """The whole page as a picture, as wide as a screen, of so many pixels for each of the page."""
        time.sleep(0.6)  # ripples and transitions of the framework
        size = {"mobile": False, "width": width, "height": 900, "deviceScaleFactor": scale}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        time.sleep(0.6)
        size["height"] = int(self.driver.execute_script("return document.documentElement.scrollHeight"))
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        time.sleep(0.4)
        self.driver.save_screenshot(str(path))
