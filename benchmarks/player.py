"""Measures a page with a player as a cold browser meets it, by the quantities of Lighthouse, and fails beyond the aims.

    python benchmarks/player.py http://127.0.0.1:8000/submissions/ID/episodes/TASK/NUMBER

The playback must be made and public; the front page can be measured, too. Scenes are rendered in software, so the
scene comes later and frames are far slower than on a graphics card. The first picture is the still.
"""

import argparse
import shutil
import sys
from typing import Any

from playwright.sync_api import sync_playwright

WINDOW = {"width": 1280, "height": 800}
SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-sandbox")
RUNS = 3
MEASURED = """async () => {
    const isReady = (form) => form !== null && !form.hidden;
    const shown = () => isReady(document.querySelector("form.transport"));
    while (!shown()) await new Promise(requestAnimationFrame);
    await new Promise(requestAnimationFrame);
    const scene = performance.now();
    const resources = performance.getEntriesByType("resource");
    const script = resources.find(({ name }) => name.includes("playback.js"));
    const { play } = document.querySelector("form.transport").elements;
    const frames = [];
    play.click();
    for (let before = performance.now(); frames.length < 40; ) {
      const now = await new Promise(requestAnimationFrame);
      frames.push(now - before);
      before = now;
    }
    const [paint] = performance.getEntriesByName("first-contentful-paint");
    const entries = (type) => new Promise((resolve) => {
      const observer = new PerformanceObserver((list) => resolve(list.getEntries()));
      observer.observe({ type, buffered: true });
      setTimeout(() => resolve([]), 300);
    });
    const largest = (await entries("largest-contentful-paint")).filter(({ url }) => url);
    const shifts = await entries("layout-shift");
    const long = await entries("longtask");
    const [page] = performance.getEntriesByType("navigation");
    return {
      "first words [ms]": paint.startTime,
      "first picture, largest contentful paint [ms]": largest[0]?.startTime ?? null,
      "scene [ms]": scene,
      "script, compressed [kB]": script.encodedBodySize / 1000,
      "all, transferred [kB]": [page, ...resources].reduce((sum, { transferSize }) => sum + transferSize, 0) / 1000,
      "layout shift": shifts.filter(({ hadRecentInput }) => !hadRecentInput).reduce((sum, { value }) => sum + value, 0),
      "blocking time [ms]": long.reduce((sum, { duration }) => sum + Math.max(0, duration - 50), 0),
      "frame, median [ms]": frames.sort((a, b) => a - b)[20],
    };
}"""


def measure(address: str) -> dict[str, Any]:
    """Return what one cold load measures."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(SOFTWARE_WEBGL))
        page = browser.new_page(viewport=WINDOW)  # type: ignore[arg-type]
        page.goto(address)
        found: dict[str, Any] = page.evaluate(MEASURED)
        browser.close()
    return found


AIMS = {
    "first picture, largest contentful paint [ms]": 2000.0,
    "script, compressed [kB]": 300.0,
    "layout shift": 0.1,
}


def list_missed(found: dict[str, Any]) -> list[str]:
    """Return the aims that a load misses, each as a sentence."""
    return [
        f"Expected {name} of at most {aim:g}, got {found[name]}."
        for name, aim in AIMS.items()
        if found[name] is None or found[name] > aim
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", help="of the page")
    address = parser.parse_args().address
    missed: list[str] = []
    for _ in range(RUNS):
        load = measure(address)
        print({name: None if value is None else round(value, 3) for name, value in load.items()})
        missed += list_missed(load)
    sys.exit("\n".join(missed) or None)
