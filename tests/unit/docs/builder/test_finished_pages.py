"""docs/builder/finished_pages.py: regions have names, and a browser runs the site's own inline scripts only."""

from base64 import b64encode
from hashlib import sha256
from pathlib import Path

import pytest
from finished_pages import COMPLETED, accessible, policy_of


def hash_of(script: str) -> str:
    return f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'"


def test_each_inline_script_is_allowed_once_by_its_hash(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "a.html").write_text("<script>one()</script><script src='x.js'></script>")
    (tmp_path / "below" / "b.html").write_text('<script>one()</script><script type="module">\ntwo()\n</script>')
    scripts = policy_of(tmp_path).split("; ")[1]
    assert scripts == " ".join(["script-src 'self'", *sorted([hash_of("one()"), hash_of("\ntwo()\n")])])


def test_a_site_without_inline_scripts_allows_none(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text("<script defer src='x.js'></script>")
    policy = policy_of(tmp_path)
    assert "script-src 'self'; " in policy
    assert policy.startswith("default-src 'none'; ")
    assert "frame-ancestors 'none'" in policy
    assert "form-action 'self'" in policy


@pytest.mark.parametrize("made", COMPLETED)
def test_pages_are_completed_once(made: str) -> None:
    page = f"<body>{made} text</body>"
    once = accessible(page)
    assert once != page
    assert accessible(once) == once
