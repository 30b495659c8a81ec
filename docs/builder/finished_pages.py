"""Completes the pages that the theme makes: what assistive technology misses, and which scripts a browser may run.

The theme has a few inline scripts, equal on all pages. The service sends the policy that allows them, and no others,
with each page of the site.
"""

import re
from base64 import b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

INLINE_SCRIPT = re.compile(r"<script(?![^>]*\bsrc=)[^>]*>(.*?)</script>", re.DOTALL)
POLICY_FILE = "content-security-policy.txt"
COMPLETED = {
    '<p class="caption" role="heading">': '<p class="caption" role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="Site">',
    '<aside class="toc-drawer">': '<aside class="toc-drawer" aria-label="On this page">',
    "<pre>": '<pre tabindex="0">',
    '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',
}
"""Levels of headings, names of regions, and focus for what scrolls sideways."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Complete the pages when all are written."""
    app.connect("build-finished", _finish)
    return {"parallel_read_safe": True}


def _finish(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        site = Path(app.outdir)
        for page in site.rglob("*.html"):
            page.write_text(accessible(page.read_text()))
        (site / POLICY_FILE).write_text(policy_of(site) + "\n")


def accessible(page: str) -> str:
    """Return a page with what assistive technology needs; a completed page stays as it is."""
    for made, completed in COMPLETED.items():
        page = page.replace(made, completed)
    return page


def policy_of(site: Path) -> str:
    """Return the Content-Security-Policy of a built site."""
    scripts = {script for page in site.rglob("*.html") for script in INLINE_SCRIPT.findall(page.read_text())}
    hashes = sorted(f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'" for script in scripts)
    return "; ".join(
        (
            "default-src 'none'",
            " ".join(("script-src 'self'", *hashes)),
            "style-src 'self' 'unsafe-inline'",
            "img-src 'self' data:",
            "connect-src 'self'",
            "base-uri 'none'",
            "form-action 'self'",
            "frame-ancestors 'none'",
        )
    )
