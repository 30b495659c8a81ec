"""Debian's chromium, driven by playwright, for tests of the pages."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, sync_playwright

ARGUMENTS = (
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-quic",
    "--disable-sync",
    "--no-first-run",
)
WITHOUT_GPU = ("--disable-gpu",)
SOFTWARE_WEBGL = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-gpu-compositing",  # only scenes are drawn as a graphics card would: it costs much to emulate one
)
NO_WEBGL = """
    const { getContext } = HTMLCanvasElement.prototype;
    HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
      return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...rest);
    };
"""


def chromium() -> str:
    """The browser's program; without one the page tests fail, they never skip."""
    found = os.environ.get("VITAC_CHROMIUM") or shutil.which("chromium")
    if not found:
        pytest.fail("No chromium: install the package `chromium`, or set VITAC_CHROMIUM to the program.", pytrace=False)
    return found


@contextmanager
def launched(*arguments: str) -> Iterator[Browser]:
    """A running browser; only one at a time, for playwright keeps an event loop in this thread."""
    given = [*ARGUMENTS, *arguments, *(["--no-sandbox"] if os.geteuid() == 0 else [])]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=given)
        yield browser
        browser.close()
