import pytest
from vitac.evaluator.shards.execution import RUNNERS
from vitac.evaluator.submission_kinds import SubmissionKind, kinds_of_board
from vitac.server.submissions.kinds import SERVED_KINDS


@pytest.mark.parametrize("kind", SubmissionKind)
def test_every_kind_is_announced_run_checked_and_shown_in_one_way(kind: SubmissionKind) -> None:
    assert kind.form.content_types
    assert kind in RUNNERS
    assert kind in SERVED_KINDS
    # What runs no policy here says what its score is worth; of a log the service shows what it claims.
    assert kind.form.runs_policy == (kind.form.worth == "")
    assert (SERVED_KINDS[kind].log_view is None) == (kind.form.runs_policy or kind.form.is_remote)


def test_no_name_of_a_file_is_of_two_kinds() -> None:
    suffixes = [suffix for kind in SubmissionKind for suffix in kind.form.suffixes]
    assert len(set(suffixes)) == len(suffixes)


def test_whatever_runs_in_our_sandbox_is_on_the_boards_of_models() -> None:
    assert kinds_of_board(SubmissionKind.MODEL) == (SubmissionKind.MODEL, SubmissionKind.IMAGE)
    assert kinds_of_board(SubmissionKind.IMAGE) == ()
    assert kinds_of_board(SubmissionKind.LOG) == (SubmissionKind.LOG,)
