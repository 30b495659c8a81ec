"""Takes in the sensor of an unpacked submission, made in the sandbox, with its document; called by `acceptance`."""

import hashlib
from pathlib import Path

import structlog
from vitac.evaluator.agent.verdicts import SandboxFailed
from vitac.evaluator.sensors.made import MadeSensor
from vitac.evaluator.sensors.manifest import SensorRejected
from vitac.evaluator.sensors.package import DesignDocument, design_document
from vitac.evaluator.submission.sensor import SensorNotMade, make_sensor

from ..database.states import FileRole
from ..errors import ProblemCode, ServiceError
from .checked_upload import UploadedFile

logger = structlog.get_logger(__name__)

NO_CHECKS = (
    "The service cannot check sensors now; nothing is wrong with yours. Try again later, and tell the organizers if it "
    "persists: `vitac doctor` on the server says what is missing."
)
_MADE_NAME = "made-sensor.json"
_DOCUMENT_NAME = "design-document"


def sensor_files(folder: Path) -> tuple[UploadedFile, ...]:
    """Return what is stored of a sensor: the one that is scored, and the design document as it is.

    Args:
        folder: of the unpacked submission; the made sensor is written beside it.

    Raises:
        ServiceError: a rule is broken, or the sandbox does not work here.
    """
    try:
        document = design_document(folder)
        made = make_sensor(folder)
    except SensorRejected as error:
        raise ServiceError(ProblemCode.SENSOR_REJECTED, str(error)) from error
    except (SensorNotMade, SandboxFailed) as error:
        logger.error("sensor_not_made", reason=str(error))
        raise ServiceError(ProblemCode.SENSOR_CHECKS_UNAVAILABLE, NO_CHECKS) from error
    return _made_file(made, folder.with_name(_MADE_NAME)), _document_file(document)


def _made_file(made: MadeSensor, path: Path) -> UploadedFile:
    content = made.as_bytes()
    path.write_bytes(content)
    return UploadedFile(
        role=FileRole.SENSOR,
        path=path,
        sha256=hashlib.sha256(content).hexdigest(),
        n_bytes=len(content),
        name=_MADE_NAME,
        facts={"mesh_digest": made.mesh_digest, **made.facts.model_dump(mode="json")},
    )


def _document_file(document: DesignDocument) -> UploadedFile:
    with document.path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return UploadedFile(
        role=FileRole.DOCUMENT,
        path=document.path,
        sha256=sha256,
        n_bytes=document.n_bytes,
        name=f"{_DOCUMENT_NAME}{document.suffix}",
    )
