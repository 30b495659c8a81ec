from pathlib import Path

import pytest
from pydantic import ValidationError
from vitac.server.errors import ServiceSettingsError
from vitac.server.settings import Registration, choose_state_directory, load_settings, others_can_enter


def test_values_come_from_the_environment_and_arguments_win(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VITAC_STATE_DIR", str(tmp_path))
    monkeypatch.setenv("VITAC_REGISTRATION", "closed")
    monkeypatch.setenv("VITAC_PORT", "9000")
    monkeypatch.setenv("VITAC_LIMITS__MEMORY_BYTES", "1000000")
    settings = load_settings(port=0)
    assert (settings.state_dir, settings.registration, settings.port) == (tmp_path, Registration.CLOSED, 0)
    assert settings.limits.memory_bytes == 1_000_000
    assert settings.limits.processes == 64


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("VITAC_PORT", "many", "VITAC_PORT is 'many'"),
        ("VITAC_REGISTRATION", "maybe", "'open', 'invite', 'approval' or 'closed'"),
        (
            "VITAC_DATABASE_URL",
            "postgresql+psycopg://u:p@h/d",
            "postgresql://USER@HOST:PORT/NAME, got the scheme 'post",
        ),
        ("VITAC_DATABASE_OWNER_URL", "host/vitac", "VITAC_DATABASE_OWNER_URL is set: expected postgresql://"),
        ("VITAC_LEASE_S", "2", "at least three renewals"),
        ("VITAC_TRUSTED_PROXIES", "10.0.0.1, proxy", "VITAC_TRUSTED_PROXIES is '10.0.0.1, proxy'"),
    ],
)
def test_wrong_value_names_the_variable(monkeypatch: pytest.MonkeyPatch, name: str, value: str, says: str) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(ServiceSettingsError) as refused:
        load_settings()
    assert says in str(refused.value)


def test_settings_cannot_be_changed_and_do_not_show_secrets() -> None:
    settings = load_settings(database_url="postgresql://u:hidden@h/d")
    with pytest.raises(ValidationError):
        settings.port = 1
    assert "hidden" not in repr(settings)


def test_state_lives_in_the_checkout_or_the_users_state_folder(tmp_path: Path) -> None:
    user_state, system = tmp_path / "user", tmp_path / "system"
    checkout = tmp_path / "checkout"

    def choose(checkout: Path | None) -> Path:
        return choose_state_directory(checkout=checkout, user_state=user_state, is_root=False, system_state=system)

    assert choose(checkout) == checkout / ".state"
    assert choose(None) == user_state / "vitac-arena"


def test_root_gets_a_system_folder_per_checkout_where_others_cannot_enter(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    system = Path("/var/lib/x")

    def choose(checkout: Path | None) -> Path:
        return choose_state_directory(checkout=checkout, user_state=tmp_path, is_root=True, system_state=system)

    one, two = choose(tmp_path / "one"), choose(tmp_path / "two")
    assert one.parent == two.parent == system
    assert one != two
    assert choose(None) == system / "default"
    assert choose(Path("/usr/src/checkout")) == Path("/usr/src/checkout/.state")


def test_a_folder_that_does_not_exist_yet_is_judged_by_those_above(tmp_path: Path) -> None:
    assert others_can_enter(Path("/usr/not/there"))
    tmp_path.chmod(0o700)
    assert not others_can_enter(tmp_path / "not" / "there")


def test_a_secret_that_cannot_be_used_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_METRICS_TOKEN", "hunter2")
    with pytest.raises(ServiceSettingsError, match=r"VITAC_METRICS_TOKEN is set: .*16") as refused:
        load_settings()
    assert "hunter2" not in str(refused.value)


def test_registration_by_invite_needs_a_code() -> None:
    with pytest.raises(ServiceSettingsError, match="VITAC_REGISTRATION is invite, so set VITAC_INVITE_CODE, too"):
        load_settings(registration="invite")
    assert load_settings(registration="invite", invite_code="a long code").registration is Registration.INVITE


@pytest.mark.parametrize(("name", "value"), [("invite_code", "short12"), ("metrics_token", "x" * 15)])
def test_a_secret_that_can_be_guessed_is_refused_unseen(name: str, value: str) -> None:
    with pytest.raises(ServiceSettingsError) as refused:
        load_settings(**{name: value})
    assert f"VITAC_{name.upper()} is set: " in str(refused.value)
    assert value not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "networks"),
    [
        ("", ()),
        (" , ", ()),
        ("10.0.0.1", ("10.0.0.1",)),
        (" 10.0.0.0/8 ,fd00::/8,", ("10.0.0.0/8", "fd00::/8")),
    ],
)
def test_trusted_proxies_are_listed_one_by_one(text: str, networks: tuple[str, ...]) -> None:
    assert load_settings(trusted_proxies=text).trusted_proxy_networks == networks


@pytest.mark.parametrize("text", ["10.0.0.1/8", "10.0.0", "proxy", "10.0.0.1;10.0.0.2"])
def test_what_is_no_network_is_refused(text: str) -> None:
    with pytest.raises(ServiceSettingsError, match=r"VITAC_TRUSTED_PROXIES is .*\. Correct or unset it\.$"):
        load_settings(trusted_proxies=text)


@pytest.mark.parametrize(("lease_s", "is_long_enough"), [(2.9, False), (3.0, True), (60.0, True)])
def test_a_lease_outlives_two_late_renewals(lease_s: float, is_long_enough: bool) -> None:
    if is_long_enough:
        assert load_settings(lease_s=lease_s, lease_renewal_s=1.0).lease_s == lease_s
    else:
        with pytest.raises(
            ServiceSettingsError, match=f"VITAC_LEASE_S is {lease_s} and VITAC_LEASE_RENEWAL_S 1.0; make"
        ):
            load_settings(lease_s=lease_s, lease_renewal_s=1.0)


def test_several_wrong_values_are_told_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_PORT", "-1")
    monkeypatch.setenv("VITAC_WORKER_SLOTS", "0")
    with pytest.raises(ServiceSettingsError) as refused:
        load_settings()
    assert "VITAC_PORT is '-1': " in str(refused.value)
    assert "VITAC_WORKER_SLOTS is '0': " in str(refused.value)
    assert str(refused.value).count("Correct or unset it.") == 2


def test_an_empty_variable_counts_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_PORT", "")
    monkeypatch.setenv("VITAC_PUBLIC_URL", "")
    assert (load_settings().port, load_settings().public_url) == (8000, None)


def test_quotas_are_set_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_QUOTAS__SCORED_RUNS_PER_DAY", "0")
    quotas = load_settings().quotas
    assert (quotas.scored_runs_per_day, quotas.attempts_per_day, quotas.tokens) == (0, 100, 20)
    with pytest.raises(ServiceSettingsError, match="VITAC_QUOTAS__TOKENS is -1"):
        load_settings(quotas={"tokens": -1})


def test_scratch_lies_in_the_state_directory(tmp_path: Path) -> None:
    assert load_settings(state_dir=tmp_path).scratch_dir == tmp_path / "scratch"
