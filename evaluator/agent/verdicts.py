"""The closed list of ways in which a policy or its evaluation can fail, each with one sentence for the team."""

import re

from vitac.errors import VitacError

from ..sentence_enum import SentenceEnum


class VerdictCode(SentenceEnum):
    """Why there is no score. The value is stable: it is stored, sent over HTTP and shown."""

    ARCHIVE_REJECTED = (
        "archive_rejected",
        "The archive breaks a rule of the upload; pack the folder again as the message says.",
    )
    MANIFEST_REJECTED = (
        "manifest_rejected",
        "submission.yaml is missing or wrong; correct the key that the message names.",
    )
    IMPORT_ERROR = "import_error", "The entry point could not be imported; the traceback in the output says where."
    LOAD_FAILED = "load_failed", "The policy's constructor raised; the traceback in the output says where."
    START_TIMEOUT = "start_timeout", "Importing and loading took longer than the start limit; load less or load faster."
    SHARED_STATE = (
        "shared_state",
        "After loading, the policy still held memory or descriptors that could carry data from one episode to the "
        "next; release them before the constructor returns.",
    )
    CRASHED = "crashed", "The policy raised or its process ended; the last lines of its output say where."
    OUT_OF_MEMORY = "out_of_memory", "The policy and its children used too much memory; use smaller models or batches."
    CPU_TIME = "cpu_time", "The policy used more CPU time than allowed; make reset() and act() cheaper."
    WALL_TIME = (
        "wall_time",
        "The policy did not answer within the wall time allowed; look for a wait, a sleep or a deadlock.",
    )
    SHARD_TIME = (
        "shard_time",
        "All episodes of a shard together took more time than allowed, with loading; make the policy cheaper.",
    )
    OUTPUT_FLOOD = "output_flood", "The policy printed more than allowed; print less."
    TOO_MANY_PROCESSES = (
        "too_many_processes",
        "The policy started more processes and threads than allowed; start fewer.",
    )
    BAD_ACTION_TYPE = (
        "bad_action_type",
        "The action is not made of real numbers; return a NumPy array, list or tuple of them.",
    )
    BAD_ACTION_SHAPE = (
        "bad_action_shape",
        "The action has the wrong shape; return the shape in the task's action table.",
    )
    NON_FINITE_ACTION = (
        "non_finite_action",
        "The action holds NaN or infinity, or overflows float32; return finite numbers.",
    )
    PROTOCOL_VIOLATION = (
        "protocol_violation",
        "The policy sent something other than one answer per question; leave the channel to the evaluator's runtime.",
    )
    LINE_LOST = (
        "line_lost",
        "The line to the remote policy could not be opened, or was cut several times; look at the policy server and at "
        "the network.",
    )
    SANDBOX_FAILED = (
        "sandbox_failed",
        "The evaluation machine failed, not the policy; the work is tried again by itself.",
    )

    def explain(self, message: str) -> str:
        """Return the sentence, and how a package comes with the submission where the message misses one."""
        missing = _MISSING_MODULE.search(message)
        return f"{self.sentence} {_BRING_PACKAGE.format(missing[1])}" if missing else self.sentence


_MISSING_MODULE = re.compile(r"No module named '(?!torch\b)(\w+)")  # of torch a worker has its own
_BRING_PACKAGE = (
    "Policies see only the packages that the page Sandbox lists. If {0} is of another one, install that into the "
    "submission's folder: `pip install --target FOLDER --only-binary :all: --no-deps PACKAGE`, with the options that "
    "docs/sandbox.md gives for the Python and the CPU of the service."
)


class PolicyFailed(VitacError):
    """The policy failed in a way that its team can mend: show them `verdict.sentence`, `message` and `output_tail`.

    Attributes:
        verdict: which of the closed list of ways.
        message: what was expected and what was received, one or a few sentences.
        output_tail: the last part of what the policy printed, at most `Limits.output_kept_bytes`.
    """

    def __init__(self, verdict: VerdictCode, message: str, output_tail: str = "") -> None:
        super().__init__(f"{verdict}: {message}")
        self.verdict = verdict
        self.message = message
        self.output_tail = output_tail


class EpisodeCut(VitacError):
    """The line to a policy server was cut in the middle of an episode: play it again from its start."""


class SandboxFailed(VitacError):
    """The isolation could not be set up or broke: repair the machine (`vitac doctor` says how), then retry the work."""

    verdict = VerdictCode.SANDBOX_FAILED
