"""A headless Chromium for tests of pages, where the machine has one (Debian: `apt-get install chromium`)."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser of Playwright's on the system's Chromium ($CHROMIUM names another); skips where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra `dev`)")
    path = os.environ.get("CHROMIUM") or next((found for name in _NAMES if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium, or set CHROMIUM to its path")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=["--disable-dev-shm-usage"])
        try:
            yield browser
        finally:
            browser.close()


class Seen:
    """A page, and what it did that it must not: errors, messages on the console, requests but for itself."""

    def __init__(self, browser: Any, path: Path, width: int = 1400, **options: Any) -> None:
        self.page = browser.new_page(viewport={"width": width, "height": 900}, **options)
        self.page.set_default_timeout(120_000)  # a busy machine may be slow
        self.wrong: list[str] = []
        self.page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        self.page.on("console", lambda message: self._told(message.text))
        address = path.resolve().as_uri()
        self.page.on("request", lambda r: r.url.startswith(address) or self.wrong.append(f"request: {r.url}"))
        self.page.on("dialog", lambda dialog: (self.wrong.append(f"dialog: {dialog.message}"), dialog.dismiss()))
        self.page.goto(address)
        self.page.wait_for_selector("html[data-drawn=yes]", timeout=120_000)

    def _told(self, text: str) -> None:
        if "willReadFrequently" not in text:  # that is of the tests, which read the canvas back
            self.wrong.append(f"console: {text}")

    def ask(self, expression: str) -> Any:
        """Value of an expression of the page's script."""
        return self.page.evaluate(expression)

    def close(self) -> None:
        """Close it; it must have done nothing wrong."""
        self.page.wait_for_timeout(50)
        self.page.close()
        if self.wrong:
            pytest.fail("\n".join(self.wrong))
