"""A submitted sensor as it is shown."""

from pydantic import Field
from vitac.evaluator.scoring.gain import SensingGain

from .base import View


class DocumentView(View):
    """The design document, which is only handed out."""

    name: str
    n_bytes: int
    sha256: str


class SensorView(View):
    """The sensor of a submission, as it was made when it was uploaded."""

    digest: str = Field(description="SHA-256 of what is scored: mesh, camera and markers.")
    mesh_digest: str = Field(description="SHA-256 of nodes and tetrahedra; `vitac sensor mesh` gives the same.")
    nodes: int
    tetrahedra: int
    is_own_mesh: bool = Field(description="The team has brought the mesh (tet.msh).")
    thickness_mm: float
    volume_mm3: float
    volume_error: float = Field(description="Of the mesh against the STL, relative.")
    distance_mm: float = Field(description="Largest one between the surfaces of mesh and STL.")
    worst_quality: float
    markers: int
    document: DocumentView
    coefficients_sha256: str | None = Field(description="Of what the standard estimator has learned; null before.")
    gain: SensingGain | None = Field(description="Standard minus blind; null until both runs are complete.")
