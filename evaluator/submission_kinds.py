"""The kinds of submission: what a track may accept, how a file of each is recognised, and how it is processed.

A new kind is a member here, a runner in `shards.execution`, an entry in `server.submissions.kinds`, and a word in the
schema's lists of kinds.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import PurePath
from types import MappingProxyType

GZIP_TYPE = "application/gzip"


@dataclass(frozen=True, kw_only=True)
class KindForm:
    """What holds for every submission of a kind."""

    content_types: tuple[str, ...]  #: how the body of an upload is announced; the first is the usual one
    suffixes: tuple[str, ...] = ()  #: how the names of its files end, without `.gz`
    is_archive: bool = False  #: a zip of a folder, which is unpacked before anything is done with it
    is_image: bool = False  #: a container image, whose own command plays
    runs_policy: bool = False  #: its policy runs in our sandbox, which alone may play a sealed list
    is_remote: bool = False  #: a policy server elsewhere chooses the actions; its folder only describes it
    is_verified: bool = False  #: it claims what an evaluation of ours found, which re-simulation confirms or refutes
    is_ranked: bool = True  #: its results have places on a board
    has_own_log: bool = False  #: its evaluation can be written as a log of ours, and verified again
    worth: str = ""  #: what its score is worth, in a few words; empty where it ranks as a model

    @property
    def has_card(self) -> bool:
        """Whether a model card says what plays, here or elsewhere."""
        return self.runs_policy or self.is_remote


class SubmissionKind(StrEnum):
    """What a team submits.

    Logs only make sense where the episode list is public: their makers must know the starts. A policy server sees
    every start, so that a list which it has played is no longer secret: it plays public lists only.
    """

    MODEL = "model"
    """A policy, which the service runs."""
    IMAGE = "image"
    """A policy as a container image, which the service runs."""
    LOG = "log"
    """An evaluation log of ours, which is verified by re-simulation."""
    REMOTE = "remote"
    """A policy server elsewhere, which chooses the actions in our physics; shown apart from models."""
    TEXT_LOG = "text_log"
    """A text log of the 2025 challenge, which is shown outside the ranking."""

    @property
    def form(self) -> KindForm:
        """What holds for all submissions of the kind."""
        return _FORMS[self]

    @property
    def board(self) -> "SubmissionKind":
        """The kind that names the boards of its results: whatever runs in our sandbox ranks together."""
        return SubmissionKind.MODEL if self.form.runs_policy else self


_FORMS: Mapping[SubmissionKind, KindForm] = MappingProxyType(
    {
        SubmissionKind.MODEL: KindForm(
            content_types=("application/zip",), suffixes=(".zip",), is_archive=True, runs_policy=True, has_own_log=True
        ),
        SubmissionKind.IMAGE: KindForm(
            content_types=("application/x-tar",), suffixes=(".tar",), is_image=True, runs_policy=True, has_own_log=True
        ),
        SubmissionKind.LOG: KindForm(
            content_types=("application/x-ndjson", "application/jsonl", GZIP_TYPE),
            suffixes=(".jsonl",),
            is_verified=True,
            has_own_log=True,
            worth="actions verified, policy not seen",
        ),
        SubmissionKind.REMOTE: KindForm(
            content_types=("application/zip",),
            is_archive=True,
            is_remote=True,
            has_own_log=True,
            worth="played in our physics, policy not seen",
        ),
        SubmissionKind.TEXT_LOG: KindForm(
            content_types=("text/plain", GZIP_TYPE), suffixes=(".log", ".txt"), is_ranked=False, worth="2025 text log"
        ),
    }
)


class Need(StrEnum):
    """What an image needs of the machine that it plays on."""

    GPU = "gpu"
    """An NVIDIA GPU and its driver."""


def kinds_of_board(kind: SubmissionKind) -> tuple[SubmissionKind, ...]:
    """Return the kinds whose results are on the boards that a kind names."""
    return tuple(each for each in SubmissionKind if each.board is kind)


POLICY_KINDS = tuple(kind for kind in SubmissionKind if kind.form.runs_policy)
"""Kinds whose submissions bring a policy."""


def kind_of_file(name: str) -> SubmissionKind:
    """Return what a file to submit is by its name; what no kind names is a model. The service checks the content."""
    path = PurePath(name.lower())
    suffix = PurePath(path.stem).suffix if path.suffix == ".gz" else path.suffix
    return next((kind for kind in SubmissionKind if suffix in kind.form.suffixes), SubmissionKind.MODEL)
