"""The closed list of ways in which a policy or its evaluation can fail, each with one sentence for the team."""

import re
from enum import StrEnum

from vitac.errors import VitacError


class VerdictCode(StrEnum):
    """Why there is no score. The value is stable: it is stored, sent over HTTP and shown."""

    ARCHIVE_REJECTED = "archive_rejected"
    MANIFEST_REJECTED = "manifest_rejected"
    IMPORT_ERROR = "import_error"
    LOAD_FAILED = "load_failed"
    START_TIMEOUT = "start_timeout"
    SHARED_STATE = "shared_state"
    CRASHED = "crashed"
    OUT_OF_MEMORY = "out_of_memory"
    CPU_TIME = "cpu_time"
    WALL_TIME = "wall_time"
    SHARD_TIME = "shard_time"
    OUTPUT_FLOOD = "output_flood"
    TOO_MANY_PROCESSES = "too_many_processes"
    BAD_ACTION_TYPE = "bad_action_type"
    BAD_ACTION_SHAPE = "bad_action_shape"
    NON_FINITE_ACTION = "non_finite_action"
    PROTOCOL_VIOLATION = "protocol_violation"
    LINE_LOST = "line_lost"
    SANDBOX_FAILED = "sandbox_failed"

    @property
    def sentence(self) -> str:
        """What happened and what to do about it."""
        return _SENTENCES[self]

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

_SENTENCES = {
    VerdictCode.ARCHIVE_REJECTED: "The archive breaks a rule of the upload; pack the folder again as the message says.",
    VerdictCode.MANIFEST_REJECTED: "submission.yaml is missing or wrong; correct the key that the message names.",
    VerdictCode.IMPORT_ERROR: "The entry point could not be imported; the traceback in the output says where.",
    VerdictCode.LOAD_FAILED: "The policy's constructor raised; the traceback in the output says where.",
    VerdictCode.START_TIMEOUT: "Importing and loading took longer than the start limit; load less or load faster.",
    VerdictCode.SHARED_STATE: (
        "After loading, the policy still held memory or descriptors that could carry data from one episode to the "
        "next; release them before the constructor returns."
    ),
    VerdictCode.CRASHED: "The policy raised or its process ended; the last lines of its output say where.",
    VerdictCode.OUT_OF_MEMORY: "The policy and its children used too much memory; use smaller models or batches.",
    VerdictCode.CPU_TIME: "The policy used more CPU time than allowed; make reset() and act() cheaper.",
    VerdictCode.WALL_TIME: (
        "The policy did not answer within the wall time allowed; look for a wait, a sleep or a deadlock."
    ),
    VerdictCode.SHARD_TIME: (
        "All episodes of a shard together took more time than allowed, with loading; make the policy cheaper."
    ),
    VerdictCode.OUTPUT_FLOOD: "The policy printed more than allowed; print less.",
    VerdictCode.TOO_MANY_PROCESSES: "The policy started more processes and threads than allowed; start fewer.",
    VerdictCode.BAD_ACTION_TYPE: "The action is not made of real numbers; return a NumPy array, list or tuple of them.",
    VerdictCode.BAD_ACTION_SHAPE: "The action has the wrong shape; return the shape in the task's action table.",
    VerdictCode.NON_FINITE_ACTION: "The action holds NaN or infinity, or overflows float32; return finite numbers.",
    VerdictCode.PROTOCOL_VIOLATION: (
        "The policy sent something other than one answer per question; leave the channel to the evaluator's runtime."
    ),
    VerdictCode.LINE_LOST: (
        "The line to the remote policy could not be opened, or was cut several times; look at the policy server and at "
        "the network."
    ),
    VerdictCode.SANDBOX_FAILED: "The evaluation machine failed, not the policy; the work is tried again by itself.",
}


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
