"""The Kubernetes example is valid in several versions, names settings that exist, and keeps the security model."""

import os
import subprocess
import time
import tomllib
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml
from databases import opened_database
from service_factories import make_principal, make_upload
from sqlalchemy import text
from vitac.server.api import health
from vitac.server.queue.work import count_open
from vitac.server.settings import Settings
from vitac.server.submissions import creation
from vitac.worker.main import ALIVE_FILE, sign_of_life
from worker_fakes import eventually

VERSIONS = ("1.30", "1.34", kubernetes_validate.latest_version())
COMPONENTS = ("server", "worker")


@pytest.fixture(scope="module")
def manifests(repository: Path) -> list[dict[str, Any]]:
    folder = repository / "docs" / "kubernetes"
    files = yaml.safe_load((folder / "kustomization.yaml").read_text())["resources"]
    assert {*files, "kustomization.yaml", "keda.yaml"} == {file.name for file in folder.iterdir()}
    return [document for file in files for document in yaml.safe_load_all((folder / file).read_text())]


@pytest.fixture(scope="module")
def keda(repository: Path) -> list[dict[str, Any]]:
    return list(yaml.safe_load_all((repository / "docs" / "kubernetes" / "keda.yaml").read_text()))


def of_kind(manifests: list[dict[str, Any]], kind: str) -> dict[str, dict[str, Any]]:
    return {document["metadata"]["name"]: document for document in manifests if document["kind"] == kind}


def pod(manifests: list[dict[str, Any]], component: str) -> dict[str, Any]:
    found: dict[str, Any] = of_kind(manifests, "Deployment")[f"vitac-arena-{component}"]["spec"]["template"]["spec"]
    return found


@pytest.mark.parametrize("version", VERSIONS)
def test_manifests_are_valid_and_have_no_unknown_field(manifests: list[dict[str, Any]], version: str) -> None:
    assert len(manifests) > 8
    for manifest in manifests:
        kubernetes_validate.validate(manifest, version, strict=True)


def test_validator_refuses_what_is_wrong(manifests: list[dict[str, Any]]) -> None:
    deployment = of_kind(manifests, "Deployment")["vitac-arena-worker"]
    wrong = deployment | {"spec": deployment["spec"] | {"replica": 3}}
    with pytest.raises(kubernetes_validate.ValidationError, match="replica"):
        kubernetes_validate.validate(wrong, VERSIONS[0], strict=True)


def test_variables_are_settings_or_credentials_of_the_bucket(manifests: list[dict[str, Any]]) -> None:
    given = {name for manifest in of_kind(manifests, "ConfigMap").values() for name in manifest["data"]}
    given |= {name for manifest in of_kind(manifests, "Secret").values() for name in manifest["stringData"]}
    given |= {entry["name"] for entry in pod(manifests, "server")["containers"][0]["env"]}
    known = {f"VITAC_{name.upper()}" for name in Settings.model_fields}
    assert {name for name in given - known if not name.startswith("AWS_")} == set()
    assert {"VITAC_DATABASE_URL", "VITAC_STORAGE_URL", "VITAC_SESSION_KEY"} <= given


def test_every_reference_has_its_object(manifests: list[dict[str, Any]]) -> None:
    kinds = {"configMapRef": of_kind(manifests, "ConfigMap"), "secretRef": of_kind(manifests, "Secret")}
    for component in COMPONENTS:
        container = pod(manifests, component)["containers"][0]
        for source in container["envFrom"]:
            ((kind, reference),) = source.items()
            assert reference["name"] in kinds[kind]
        volumes = {volume["name"] for volume in pod(manifests, component)["volumes"]}
        assert volumes == {mount["name"] for mount in container["volumeMounts"]}
        labels = of_kind(manifests, "Deployment")[f"vitac-arena-{component}"]["spec"]["template"]["metadata"]["labels"]
        assert labels["app.kubernetes.io/component"] == component
    assert (
        of_kind(manifests, "Service")["vitac-arena-server"]["spec"]["selector"].items()
        <= {
            "app.kubernetes.io/name": "vitac-arena",
            "app.kubernetes.io/component": "server",
        }.items()
    )


def test_sandboxes_run_on_gvisor_and_workers_have_no_secret_of_the_servers_and_no_network_of_the_cluster(
    manifests: list[dict[str, Any]],
) -> None:
    worker = pod(manifests, "worker")
    assert {"secretRef": {"name": "vitac-arena-server"}} not in worker["containers"][0]["envFrom"]
    for component in COMPONENTS:  # both build sandboxes
        assert pod(manifests, component)["runtimeClassName"] in of_kind(manifests, "RuntimeClass")
    policy = of_kind(manifests, "NetworkPolicy")["vitac-arena-worker"]["spec"]
    assert policy["policyTypes"] == ["Ingress", "Egress"]
    assert policy["ingress"] == []
    assert all("ports" in rule for rule in policy["egress"])


@pytest.mark.parametrize("component", COMPONENTS)
def test_pods_run_without_privileges(manifests: list[dict[str, Any]], component: str) -> None:
    spec = pod(manifests, component)
    assert spec["automountServiceAccountToken"] is False
    assert spec["securityContext"]["runAsNonRoot"] is True
    assert spec["securityContext"]["runAsUser"] == 10001
    (container,) = spec["containers"]
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert container["resources"]["limits"]["memory"]


def test_probes_ask_routes_that_exist(manifests: list[dict[str, Any]]) -> None:
    (container,) = pod(manifests, "server")["containers"]
    probes = {name: container[f"{name}Probe"]["httpGet"]["path"] for name in ("startup", "liveness", "readiness")}
    assert probes == {"startup": "/health", "liveness": "/health", "readiness": "/ready"}
    assert set(probes.values()) <= {getattr(route, "path", None) for route in health.router.routes}


def test_scaled_object_has_its_target_and_its_secret(
    keda: list[dict[str, Any]], manifests: list[dict[str, Any]]
) -> None:
    authentication, scaled = keda
    assert scaled["spec"]["scaleTargetRef"]["name"] in of_kind(manifests, "Deployment")
    (trigger,) = scaled["spec"]["triggers"]
    assert trigger["authenticationRef"]["name"] == authentication["metadata"]["name"]
    (connection,) = authentication["spec"]["secretTargetRef"]
    assert connection["key"] in of_kind(manifests, "Secret")[connection["name"]]["stringData"]


def test_query_of_the_scaled_object_counts_what_the_queue_does(keda: list[dict[str, Any]]) -> None:
    (trigger,) = keda[1]["spec"]["triggers"]
    with opened_database() as database:
        with database.transaction() as session:
            creation.create(session, make_principal(session), make_upload(archive_sha256="0" * 64))
        with database.transaction() as session:
            counted = session.scalar(text(trigger["metadata"]["query"]))
            assert counted == count_open(session) > 1


def test_images_are_of_this_release(manifests: list[dict[str, Any]], repository: Path) -> None:
    release = tomllib.loads((repository / "pyproject.toml").read_text())["project"]["version"]
    for component in COMPONENTS:
        (container,) = pod(manifests, component)["containers"]
        assert container["image"].endswith(f"/vitac-arena-{component}:{release}")
    base = yaml.safe_load((repository / "docs" / "kubernetes" / "kustomization.yaml").read_text())
    assert {image["newTag"] for image in base["images"]} == {release}


def test_probes_of_workers_look_at_the_file_that_a_living_worker_touches(
    manifests: list[dict[str, Any]], repository: Path, tmp_path: Path
) -> None:
    container = pod(manifests, "worker")["containers"][0]
    compose = yaml.safe_load((repository / "docker-compose.yml").read_text())["services"]["worker"]["healthcheck"]
    commands = {container[probe]["exec"]["command"][-1] for probe in ("startupProbe", "livenessProbe")}
    commands.add(compose["test"][-1].replace("$$", "$"))
    (command,) = commands
    state = next(mount["mountPath"] for mount in container["volumeMounts"] if mount["name"] == "state")
    assert f"{state}/{ALIVE_FILE}" in command

    def is_healthy() -> bool:
        here = command.replace(state, str(tmp_path))
        return subprocess.run(["sh", "-c", here], stderr=subprocess.DEVNULL).returncode == 0

    assert not is_healthy()
    with sign_of_life(tmp_path):
        eventually(is_healthy)
        minutes_ago = time.time() - 120
        os.utime(tmp_path / ALIVE_FILE, (minutes_ago, minutes_ago))
        assert not is_healthy()
    assert not (tmp_path / ALIVE_FILE).exists()


def test_an_image_without_the_player_is_not_built(repository: Path) -> None:
    lines = (repository / "docker" / "Dockerfile").read_text().splitlines()
    assert "RUN setup/build_viewer.sh /opt/vitac/bin/python" in lines
