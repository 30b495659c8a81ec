import pytest
from vitac.cli.admin.consent import ConsentMissing, require_consent


def test_consent_is_needed_where_nobody_can_be_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ConsentMissing, match="--yes"):
        require_consent("Cancel?", yes=False)
    require_consent("Cancel?", yes=True)
