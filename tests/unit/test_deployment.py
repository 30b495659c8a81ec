"""The compose file and the images agree with each other, with the settings and with the security model.

No container engine is needed: the file is read as the compose model reads it (merge keys, interpolation), with every
key checked against those that this project uses on purpose.
"""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from vitac.server.database.cluster import MAX_CONNECTIONS
from vitac.server.database.schema import service_role
from vitac.server.settings import Settings

SERVICE_KEYS = {
    *(
        "build",
        "cap_drop",
        "command",
        "depends_on",
        "environment",
        "healthcheck",
        "image",
        "init",
        "mem_limit",
        "networks",
    ),
    *("pids_limit", "ports", "read_only", "restart", "security_opt", "shm_size", "stop_grace_period", "tmpfs"),
    "volumes",
}
HEALTHCHECK_KEYS = {"test", "interval", "timeout", "retries", "start_period"}
VARIABLE = re.compile(r"\$\{([A-Z_]+)(:[-?][^}]*)?\}")
"""To what lies in another folder."""

PASSED_ON = re.compile(r"^ +((?:VITAC|AWS)_[A-Z_]+):$", re.MULTILINE)


@pytest.fixture(scope="module")
def compose(repository: Path) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((repository / "docker-compose.yml").read_text())
    return document


@pytest.fixture(scope="module")
def services(compose: dict[str, Any]) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = compose["services"]
    return found


@pytest.fixture(scope="module")
def dockerfile(repository: Path) -> str:
    return (repository / "docker" / "Dockerfile").read_text()


def test_images_are_of_any_architecture(dockerfile: str, services: dict[str, dict[str, Any]]) -> None:
    assert not re.search(r"--platform|x86|amd64|arm64|aarch64", dockerfile)
    assert not any("platform" in service for service in services.values())


def test_uses_only_keys_of_the_compose_model(compose: dict[str, Any], services: dict[str, dict[str, Any]]) -> None:
    assert {key for key in compose if not key.startswith("x-")} == {"services", "volumes", "networks"}
    for name, service in services.items():
        assert not set(service) - SERVICE_KEYS, name
        assert not set(service.get("healthcheck", {})) - HEALTHCHECK_KEYS, name


def test_declares_every_volume_and_network_it_uses(
    compose: dict[str, Any], services: dict[str, dict[str, Any]]
) -> None:
    mounts = [mount.split(":")[0] for service in services.values() for mount in service.get("volumes", [])]
    # One without a name is the container's own, "." begins a file of the repository.
    volumes = {mount for mount in mounts if not mount.startswith(("/", "."))}
    networks = {network for service in services.values() for network in service["networks"]}
    assert volumes == set(compose["volumes"])
    assert networks == set(compose["networks"])


def test_waits_only_for_services_that_report_their_health(services: dict[str, dict[str, Any]]) -> None:
    for service in services.values():
        for other, how in service.get("depends_on", {}).items():
            assert how == {"condition": "service_healthy"}
            assert "healthcheck" in services[other]


def test_builds_targets_that_the_dockerfile_has(services: dict[str, dict[str, Any]], dockerfile: str) -> None:
    stages = set(re.findall(r"^FROM \S+ AS (\w+)$", dockerfile, re.MULTILINE))
    targets = {service["build"]["target"] for service in services.values() if "build" in service}
    assert targets == {"server", "worker"}
    assert targets <= stages


def test_pins_every_image_by_name_and_version(services: dict[str, dict[str, Any]], dockerfile: str) -> None:
    stages = set(re.findall(r"^FROM \S+ AS (\w+)$", dockerfile, re.MULTILINE))
    images = set(re.findall(r"^FROM (\S+) AS", dockerfile, re.MULTILINE)) - stages
    images |= {service["image"] for service in services.values() if "image" in service}
    assert images
    named = r"[a-z]+:\d[\w.]*-\w[\w-]*(@sha256:[0-9a-f]{64})?"
    assert all(re.fullmatch(named, image) for image in images), images


def test_base_images_are_named_by_digest_all_or_none(repository: Path, tmp_path: Path) -> None:
    for name in ("docker/Dockerfile", "docker/pin.sh", "docker-compose.yml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(repository / name, tmp_path / name)
    engine = tmp_path / "docker" / "docker"  # stands for the program, which asks a registry

    def pin(*arguments: str, digest: str) -> tuple[int, str]:
        engine.write_text(f"#!/bin/sh\necho sha256:{digest}\n" if digest else "#!/bin/sh\nexit 1\n")
        engine.chmod(0o755)
        path = f"{engine.parent}:/usr/bin:/bin"
        command = [str(tmp_path / "docker" / "pin.sh"), *arguments]
        done = subprocess.run(command, env={"PATH": path}, capture_output=True, text=True)
        return done.returncode, done.stderr

    before = (tmp_path / "docker" / "Dockerfile").read_text()
    assert pin(digest="")[0] != 0
    assert (tmp_path / "docker" / "Dockerfile").read_text() == before
    code, said = pin("--check", digest="")
    assert (code, said.count("by version only")) == (1, 2)
    for digest in ("1" * 64, "2" * 64):
        assert pin(digest=digest) == (0, "")
        assert pin("--check", digest="") == (0, "")
        pinned = (tmp_path / "docker" / "Dockerfile").read_text()
        assert pinned.count(f"FROM python:3.11-slim-bookworm@sha256:{digest} AS") == 2
    assert f"postgres:17-bookworm@sha256:{digest}\n" in (tmp_path / "docker-compose.yml").read_text()


def test_a_build_for_others_may_demand_digests(dockerfile: str) -> None:
    assert 'ARG PINNED=\nRUN docker/pin.sh --check || test -z "$PINNED"\n' in dockerfile


def test_a_player_that_cannot_be_bundled_fails_the_build(dockerfile: str) -> None:
    (line,) = (line for line in dockerfile.splitlines() if "build_viewer.sh" in line)
    assert line == "RUN setup/build_viewer.sh /opt/vitac/bin/python"


def test_the_database_takes_as_many_connections_as_the_documents_say(
    repository: Path, services: dict[str, dict[str, Any]]
) -> None:
    taken = int(services["postgres"]["command"].partition("max_connections=")[2])
    (row,) = (line for line in (repository / "docs/capacity.md").read_text().splitlines() if "max_connections" in line)
    of_worker, of_server, _, documented, workers, servers = map(int, re.findall(r"\b\d+\b", row))
    assert taken == documented == MAX_CONNECTIONS
    assert of_worker * workers + of_server * servers <= taken


def test_sets_only_settings_that_exist(services: dict[str, dict[str, Any]], dockerfile: str) -> None:
    known = {f"VITAC_{name.upper()}" for name in Settings.model_fields} | {"VITAC_CACHE_DIR", "VITAC_MEMORY_DIR"}
    used = {name for service in services.values() for name in service.get("environment", {}) if "POSTGRES_" not in name}
    used |= set(re.findall(r"\b(VITAC_[A-Z_]+)=", dockerfile))
    assert "VITAC_DATABASE_URL" in used
    assert not used - known


def test_has_no_secret_of_its_own(repository: Path, services: dict[str, dict[str, Any]]) -> None:
    assert services["postgres"]["environment"]["POSTGRES_PASSWORD"].startswith("${VITAC_POSTGRES_OWNER_PASSWORD:?")
    assert "VITAC_POSTGRES_PASSWORD:?" in services["server"]["environment"]["VITAC_DATABASE_URL"]


def test_the_service_works_as_a_role_that_owns_no_table(repository: Path, services: dict[str, dict[str, Any]]) -> None:
    """Only the server also has the address of the owner; the other role is made with the database."""
    owner = services["postgres"]["environment"]["POSTGRES_USER"]
    script = (repository / "docker" / "service_role.sh").read_text()
    made = re.findall(r"^CREATE ROLE (\w+) LOGIN PASSWORD :'password';$", script, re.MULTILINE)
    for name in ("server", "worker"):
        assert [service_role(_filled(services[name]["environment"]["VITAC_DATABASE_URL"]))] == made
        assert owner not in made
    assert service_role(_filled(services["server"]["environment"]["VITAC_DATABASE_OWNER_URL"])) == owner
    assert "VITAC_DATABASE_OWNER_URL" not in services["worker"]["environment"]
    mounts = [mount.split(":") for mount in services["postgres"]["volumes"]]
    assert ["./docker/service_role.sh", "/docker-entrypoint-initdb.d/service_role.sh", "ro"] in mounts


def _filled(address: str) -> str:
    """The address with a password."""
    return VARIABLE.sub("password", address)


def test_whoever_runs_it_says_who_may_register_and_with_which_code(services: dict[str, dict[str, Any]]) -> None:
    environment = services["server"]["environment"]
    assert environment["VITAC_REGISTRATION"] == "${VITAC_REGISTRATION:-open}"
    assert environment["VITAC_INVITE_CODE"] is None, "passed on as it is set; empty counts as not set"


def test_every_variable_is_explained(repository: Path) -> None:
    asked = set()
    for name in ("docker-compose.yml", "docker-compose.s3.yml"):
        content = (repository / name).read_text()
        asked |= {name for name, _ in VARIABLE.findall(content)} | set(PASSED_ON.findall(content))
    manual = (repository / "docs" / "deployment.md").read_text()
    assert asked
    assert {name for name in asked if f"`{name}`" not in manual} == set()


def test_services_of_ours_run_without_privileges(services: dict[str, dict[str, Any]], dockerfile: str) -> None:
    for name in ("server", "worker"):
        assert services[name]["cap_drop"] == ["ALL"]
        assert services[name]["read_only"] is True
        assert "no-new-privileges:true" in services[name]["security_opt"]
        last_user = re.findall(r"^USER (\w+)$", dockerfile.split(f"AS {name}\n")[1].split("\nFROM ")[0], re.MULTILINE)
        assert (last_user or ["vitac"])[-1] == "vitac"


def test_only_the_worker_may_build_sandboxes(services: dict[str, dict[str, Any]], dockerfile: str) -> None:
    loosened = {"seccomp=unconfined", "apparmor=unconfined", "systempaths=unconfined"}
    assert loosened <= set(services["worker"]["security_opt"])
    for name in ("server", "postgres"):
        assert not loosened & set(services[name].get("security_opt", ()))
    for name in ("server", "worker"):
        assert f"FROM runtime AS {name}\n" in dockerfile
    assert "bubblewrap" in dockerfile.split(" AS runtime\n")[1].split("\nFROM ")[0]


def test_worker_reaches_nothing_outside(compose: dict[str, Any], services: dict[str, dict[str, Any]]) -> None:
    assert services["worker"]["networks"] == ["inside"]
    assert compose["networks"]["inside"] == {"internal": True}
    assert "ports" not in services["worker"]


def test_worker_unpacks_submissions_on_a_disk_that_may_execute(services: dict[str, dict[str, Any]]) -> None:
    """Engines mount a tmpfs without the right to execute, and what is on it counts towards the memory limit."""
    state = "/var/lib/vitac-arena/state"
    for name in ("server", "worker"):
        assert not [mount for mount in services[name]["tmpfs"] if mount.startswith(state)]
        assert [mount for mount in services[name]["volumes"] if mount.endswith(state)]


def test_database_counts_as_healthy_once_it_takes_connections_over_tcp(services: dict[str, dict[str, Any]]) -> None:
    assert "--host 127.0.0.1" in services["postgres"]["healthcheck"]["test"][1]


def test_bucket_is_reached_by_server_and_worker_with_the_same_settings(
    repository: Path, services: dict[str, dict[str, Any]]
) -> None:
    changed = yaml.safe_load((repository / "docker-compose.s3.yml").read_text())["services"]
    assert changed["server"]["environment"] == changed["worker"]["environment"]
    assert {"VITAC_STORAGE_URL", "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_ENDPOINT_URL"} <= changed["server"][
        "environment"
    ].keys()
    for name in ("server", "worker"):
        assert {*services[name]["networks"], *changed[name].get("networks", ())} == {"inside", "outside"}


def test_server_listens_on_this_machine_unless_told_otherwise(services: dict[str, dict[str, Any]]) -> None:
    assert services["server"]["ports"] == ["${VITAC_BIND:-127.0.0.1:8000}:8000"]


def test_image_context_holds_what_the_wheel_is_built_from(repository: Path) -> None:
    lines = (repository / ".dockerignore").read_text().splitlines()
    assert "*" in lines
    project = tomllib.loads((repository / "pyproject.toml").read_text())
    folders = set(project["tool"]["setuptools"]["package-dir"].values())
    assert "server" in folders
    kept = {line[1:] for line in lines if line.startswith("!")}
    pinning = {"docker/Dockerfile", "docker/pin.sh"}
    assert kept == folders | pinning | {
        "setup",
        "viewer",
        "LICENSE",
        "NOTICE",
        "README.md",
        "pyproject.toml",
        "requirements",
    }
