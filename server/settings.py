"""The service's settings and its state directory."""

import hashlib
import os
import stat
from enum import StrEnum
from functools import cached_property
from importlib.util import find_spec
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Any, Self
from urllib.parse import urlsplit

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PositiveFloat,
    PositiveInt,
    SecretStr,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, SettingsConfigDict
from vitac.evaluator.agent.limits import Limits

from .errors import ServiceSettingsError

SYSTEM_STATE = Path("/var/lib/vitac-arena")


def default_state_directory() -> Path:
    """Return `.state` of the checkout, else the user's state folder; for root, one in /var/lib where that is needed."""
    return choose_state_directory(
        checkout=checkout_directory(), user_state=_user_state(), is_root=os.geteuid() == 0, system_state=SYSTEM_STATE
    )


def choose_state_directory(*, checkout: Path | None, user_state: Path, is_root: bool, system_state: Path) -> Path:
    """Return the rule behind `default_state_directory`, with all that it depends on passed in."""
    wanted = checkout / ".state" if checkout is not None else user_state / "vitac-arena"
    if not is_root or others_can_enter(wanted.parent):
        return wanted
    if checkout is None:
        return system_state / "default"
    return system_state / hashlib.sha256(str(checkout).encode()).hexdigest()[:12]


def others_can_enter(folder: Path) -> bool:
    """Return whether a user who owns nothing can reach this folder: all above have their x bit for others."""
    existing = [path for path in (folder, *folder.parents) if path.exists()]
    return all(path.stat().st_mode & stat.S_IXOTH for path in existing)


def checkout_directory() -> Path | None:
    """Return the source tree that this package runs from, or None when it was installed from a wheel."""
    spec = find_spec("vitac.server")
    if spec is None or spec.origin is None:
        return None
    root = Path(spec.origin).resolve().parent.parent
    is_checkout = (root / "pyproject.toml").is_file() and (root / "migrations").is_dir()
    return root if is_checkout and os.access(root, os.W_OK) else None


def _user_state() -> Path:
    configured = os.environ.get("XDG_STATE_HOME", "")
    return Path(configured) if configured.startswith("/") else Path.home() / ".local" / "state"


class Registration(StrEnum):
    """Who may register a team."""

    OPEN = "open"  # anybody who reaches the server
    INVITE = "invite"  # whoever has the invite code
    APPROVAL = "approval"  # anybody, but an organizer has to accept the team before it submits
    CLOSED = "closed"  # organizers only


class OutdatedRule(StrEnum):
    """What becomes of evaluations that began with another evaluator version than the service has."""

    RESTART = "restart"  # they are restarted with the service's, once no worker of theirs takes shards
    FINISH = "finish"  # workers of their version finish those that run; those that wait are restarted


MAIL_SCHEMES = ("smtp", "smtps", "smtp+starttls", "file")
"""Schemes that `mail_url` may have."""


class LogFormat(StrEnum):
    """How service events are written on standard error, one line each."""

    TEXT = "text"  # key='value' pairs, for people
    JSON = "json"  # JSON objects, for programs


Limit = Annotated[int, Field(ge=0)] | None


class Quotas(BaseModel):
    """What each team may have, unless `vitac admin quota set` gives it a limit of its own; null: any number."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scored_runs_per_day: Limit = Field(
        default=None, description="Evaluations of a day (UTC) that end with a score or may still do so."
    )
    attempts_per_day: Limit = Field(default=100, description="Evaluations of a day (UTC), however they end.")
    queued_at_once: Limit = Field(default=50, description="Evaluations that wait or run.")
    stored_mib: Limit = Field(
        default=8192, description="Stored uploads [MiB] and those being sent; cancelled ones are removed after a day."
    )
    tokens: Limit = Field(default=20, description="Valid tokens.")
    event_streams: Limit = Field(default=20, description="Open event streams, of API and pages together.")


class Settings(BaseSettings):
    """Settings of server and worker. Sizes in bytes, times in seconds unless the name says otherwise."""

    model_config = SettingsConfigDict(
        env_prefix="VITAC_", env_nested_delimiter="__", env_ignore_empty=True, frozen=True, extra="forbid"
    )

    database_url: SecretStr | None = Field(
        default=None,
        description="PostgreSQL to use (postgresql://...). Not set: an embedded one in the state directory.",
    )
    database_owner_url: SecretStr | None = Field(
        default=None,
        description="The same database for the role that owns its tables, who migrates and restores. Not set: "
        "VITAC_DATABASE_URL.",
    )
    database_wait_s: PositiveFloat = Field(
        default=30.0,
        description="How long a starting server or worker waits for a database that does not answer; for one that "
        "recovers or restarts, without limit.",
    )
    state_dir: Path = Field(
        default_factory=default_state_directory,
        description="Folder of the embedded database, of stored files and of keys; `.state` in the checkout where "
        "there is one.",
    )
    postgres_bin_dir: Path | None = Field(
        default=None,
        description="Folder with initdb and postgres for the embedded database. Not set: the newest found.",
    )
    preview_font: Path | None = Field(
        default=None,
        description="Font file for further scripts, such as Noto Sans CJK, in the previews of links. Not set: "
        "Latin, Greek and Cyrillic.",
    )
    storage_url: str | None = Field(
        default=None,
        description="Where uploads are stored: s3://bucket/prefix or file:///folder. Not set: in the state directory.",
    )
    session_key: SecretStr | None = Field(
        default=None,
        description="Key that signs page sessions, equal on all servers. Not set: a file in the state directory.",
    )

    host: str = Field(default="127.0.0.1", description="Address at which the server listens.")
    port: int = Field(default=8000, ge=0, le=65535, description="Port at which the server listens.")
    server_processes: PositiveInt = Field(
        default=1, description="Processes that answer requests; one uses about one core."
    )
    public_url: str | None = Field(
        default=None,
        description="Address that people use; all links follow it. `vitac serve` needs it where VITAC_HOST is not "
        "of this machine alone.",
    )

    remote_addresses: str = Field(
        default="",
        description="Policy servers that workers may ask, as submissions of kind `remote` name them "
        "(ws://policy.example.org:8000), with commas; none by default.",
    )

    remote_gate: str = Field(
        default="",
        description="Inner address of `vitac gate`, such as ws://127.0.0.1:8101, where server and workers ask policies "
        "that dial in; none by default.",
    )

    trusted_proxies: str = Field(
        default="",
        description="Addresses or networks (10.0.0.0/8) of the reverse proxies, with commas; X-Forwarded-For counts "
        "from nobody else.",
    )

    metrics_token: SecretStr | None = Field(
        default=None,
        min_length=16,
        description="Token that may read /metrics, of 16 characters or more; organizers always may.",
    )
    log_format: LogFormat = Field(
        default=LogFormat.TEXT, description="How service events are written: text, or json with one object per line."
    )

    registration: Registration = Field(
        default=Registration.OPEN, description="Who may register a team: open, invite, approval or closed."
    )
    invite_code: SecretStr | None = Field(
        default=None,
        min_length=8,
        description="What a team must know to register with VITAC_REGISTRATION=invite, at least 8 characters.",
    )
    registrations_per_hour: PositiveInt = Field(
        default=20, description="Maximum registrations from one client address in an hour."
    )
    sign_ins_per_hour: PositiveInt = Field(
        default=60,
        description="Maximum sign-in attempts with a password from one client address in an hour; a quarter of it "
        "as one member, or on a device that has signed in before.",
    )
    client_share: PositiveFloat = Field(
        default=0.1,
        description="Part of a server process's time that one visitor's address, or one team, may use in the long "
        "run, after 10 s at once; at most 48 of its requests wait. 1: all of it.",
    )
    token_lifetime_days: PositiveInt = Field(default=365, description="How long a new API token is valid.")
    limits: Limits = Field(
        default_factory=Limits,
        description="Limits on archives and policies; one by one (VITAC_LIMITS__MEMORY_BYTES) or as JSON.",
    )
    quotas: Quotas = Field(
        default_factory=Quotas,
        description="Limits of each team; one by one (VITAC_QUOTAS__ATTEMPTS_PER_DAY) or as JSON.",
    )
    mail_url: SecretStr | None = Field(
        default=None,
        description="Server that sends e-mails: smtp://, smtps:// or smtp+starttls://USER:PASSWORD@HOST:PORT, or "
        "file:///folder, which stores them. For your own certificate authority set SSL_CERT_FILE. Not "
        "set: none are sent.",
    )
    mail_from: str = Field(
        default="vitac-arena@localhost",
        pattern=r"^[^\s@<>]+@[^\s@<>]+$",
        description="Sender of the e-mails; only its address.",
    )
    webhooks_may_lead_inside: bool = Field(
        default=False, description="Whether webhooks may use http and hosts outside the public internet."
    )
    contacts_kept_days: PositiveInt | None = Field(
        default=None,
        description="How long addresses of teams and members are stored after the end of the competition; not set: "
        "without limit.",
    )
    log_bytes: PositiveInt = Field(
        default=32 << 20,
        description="Largest log that may be uploaded, packed and unpacked; 2025 text logs have 8 MiB at most.",
    )
    uploads_at_once: PositiveInt = Field(default=2, description="Maximum simultaneous uploads of one team.")
    upload_idle_timeout_s: PositiveFloat = Field(
        default=30.0, description="An upload that sends nothing for this time is given up."
    )
    unfinished_uploads: PositiveInt = Field(default=4, description="Maximum unfinished resumable uploads of one team.")
    upload_kept_h: PositiveInt = Field(
        default=24, description="A resumable upload without a further piece for this time is removed."
    )
    event_streams: PositiveInt = Field(
        default=1000,
        description="Maximum open event streams of a server; teams have nine tenths, teams of one address a fifth.",
    )

    playbacks_at_once: PositiveInt = Field(
        default=4, description="Maximum playbacks of one team that wait or are being made."
    )
    playbacks_per_hour: PositiveInt = Field(
        default=60, description="Maximum new playbacks in an hour for one team, or for all visitors together."
    )
    playbacks_per_address: PositiveInt = Field(
        default=10, description="Maximum playbacks in an hour for visitors from one address."
    )
    playbacks_kept_days: PositiveInt = Field(
        default=30, description="Playbacks requested longer ago are removed, and made again on request."
    )

    lease_s: PositiveFloat = Field(
        default=6.0, description="A shard whose worker does not renew its lease for this time goes to another one."
    )
    lease_renewal_s: PositiveFloat = Field(
        default=1.0,
        description="How often a worker renews its lease, at most a third of the lease; bounds the time a cancel "
        "takes.",
    )
    sweep_interval_s: PositiveFloat = Field(default=2.0, description="Pause between two sweeps for lost shards.")
    shard_attempts: PositiveInt = Field(
        default=3, description="How often a shard is started without progress before the evaluation fails."
    )
    shard_idle_timeout_s: PositiveFloat = Field(
        default=1800.0, description="A shard's process that finishes no episode for this time is ended and tried again."
    )
    worker_heartbeat_s: PositiveFloat = Field(default=2.0, description="How often a worker reports that it is alive.")
    worker_lost_after_s: PositiveFloat = Field(
        default=15.0, description="A worker without a heartbeat for this time is lost."
    )
    outdated_evaluations: OutdatedRule = Field(
        default=OutdatedRule.RESTART,
        description="What an upgrade of the evaluator does to evaluations that run: `finish` them on workers of the "
        "version that they began with, or `restart` them with the new one. The server that starts last decides.",
    )
    worker_gpu: bool = Field(
        default=False, description="Workers here play images that need a GPU, too (`vitac worker --gpu`)."
    )
    worker_slots: PositiveInt = Field(default=1, description="Shards that one worker process runs at the same time.")

    @model_validator(mode="after")
    def _lease_outlives_renewal(self) -> Self:
        if self.lease_s < 3 * self.lease_renewal_s:
            raise ValueError(
                f"VITAC_LEASE_S is {self.lease_s} and VITAC_LEASE_RENEWAL_S {self.lease_renewal_s}; "
                "make the lease at least three renewals long, or one late renewal loses the shard"
            )
        return self

    @model_validator(mode="after")
    def _invite_has_a_code(self) -> Self:
        if self.registration is Registration.INVITE and self.invite_code is None:
            raise ValueError("VITAC_REGISTRATION is invite, so set VITAC_INVITE_CODE, too")
        return self

    @field_validator("database_url", "database_owner_url")
    @classmethod
    def _is_an_address_of_postgresql(cls, url: SecretStr | None) -> SecretStr | None:
        scheme = url and urlsplit(url.get_secret_value()).scheme
        if scheme not in (None, "postgresql", "postgres"):
            raise ValueError(f"expected postgresql://USER@HOST:PORT/NAME, got the scheme {scheme!r}")
        return url

    @field_validator("mail_url")
    @classmethod
    def _is_known_kind_of_mail(cls, url: SecretStr | None) -> SecretStr | None:
        if url is not None and urlsplit(url.get_secret_value()).scheme not in MAIL_SCHEMES:
            raise ValueError(f"expected a scheme of {', '.join(MAIL_SCHEMES)}")
        return url

    @property
    def allowed_remote_addresses(self) -> tuple[str, ...]:
        """The addresses of policy servers, one by one."""
        return _parts(self.remote_addresses)

    @field_validator("trusted_proxies")
    @classmethod
    def _are_networks(cls, text: str) -> str:
        for part in _parts(text):
            ip_network(part)
        return text

    @property
    def trusted_proxy_networks(self) -> tuple[str, ...]:
        """The trusted proxies, one by one."""
        return _parts(self.trusted_proxies)

    @cached_property
    def scratch_dir(self) -> Path:
        """Folder for files that live only while something runs."""
        return self.state_dir / "scratch"


def _parts(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def load_settings(**overrides: Any) -> Settings:
    """Return the settings of this process; values given here win over the environment.

    Raises:
        ServiceSettingsError: a variable has a value that cannot be used.
    """
    try:
        return Settings(**overrides)
    except ValidationError as error:
        raise ServiceSettingsError(
            " ".join(_sentence(problem) for problem in error.errors(include_url=False))
        ) from error


def _sentence(problem: Any) -> str:
    name = "__".join(str(part) for part in problem["loc"]).upper()
    field = Settings.model_fields.get(str(problem["loc"][0])) if problem["loc"] else None
    is_secret = field is not None and field.annotation == SecretStr | None
    given = "set" if is_secret else f"{problem['input']!r:.80}"
    place = f"VITAC_{name} is {given}: " if name else ""
    return f"{place}{problem['msg'].removeprefix('Value error, ')}. Correct or unset it."
