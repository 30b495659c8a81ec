import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from databases import opened_database
from service_client import make_archive
from service_factories import make_settings
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore

FAST = {"lease_s": 1.5, "lease_renewal_s": 0.1, "sweep_interval_s": 0.1, "worker_heartbeat_s": 0.1}


@pytest.fixture
def services(tmp_path: Path) -> Iterator[Services]:
    """Open services with quick leases on a fresh database."""
    with opened_database() as database:
        settings = make_settings(state_dir=tmp_path, database_url=database.address, **FAST)
        settings.scratch_dir.mkdir()
        yield Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None)


@pytest.fixture
def archive_sha256(services: Services, tmp_path: Path) -> str:
    """A stored, valid submission."""
    path = tmp_path / "archive.zip"
    path.write_bytes(make_archive())
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    services.blobs.put(path, digest)
    return digest
