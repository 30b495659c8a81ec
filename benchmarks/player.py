"""Measures the page of an episode as a cold browser meets it: its first picture, its scene, its weight, its frames.

    python benchmarks/player.py http://127.0.0.1:8000/submissions/ID/episodes/TASK/NUMBER

The playback must be made and public. Scenes are rendered in software, so frames are far slower than on a graphics card.
"""

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
    const still = resources.find(({ name }) => name.includes("/still"));
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
    return {
      "first words [ms]": paint.startTime,
      "first picture [ms]": still?.responseEnd ?? null,
      "scene [ms]": scene,
      "script, compressed [kB]": script.encodedBodySize / 1000,
      "all, transferred [kB]": resources.reduce((sum, { transferSize }) => sum + transferSize, 0) / 1000,
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


if __name__ == "__main__":
    for _ in range(RUNS):
        print({name: None if value is None else round(value, 1) for name, value in measure(sys.argv[1]).items()})
