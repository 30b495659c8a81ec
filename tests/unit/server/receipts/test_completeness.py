"""What an audit says of results that are missing on a board, on made-up exports of one team or two."""

from datetime import timedelta
from typing import Any
from uuid import UUID

import pytest
from made_logs import apply_file
from made_receipts import KEY, PUBLIC_KEY, WHEN, a_result, arrival_of, prove, receipt_for
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind
from vitac.evaluator.tracks.sealed import make_commitment
from vitac.server.receipts.completeness import (
    check_arrivals,
    check_end,
    check_entries,
    check_head,
    check_noted,
    check_opened,
    check_order,
    check_repeated_end,
    check_secret,
    check_submissions,
    check_teams,
    check_winners,
    check_witnessed,
)
from vitac.server.receipts.export import ExportDescription, ExportedTeam
from vitac.server.receipts.receipt import (
    End,
    EndReceipt,
    JudgedEntry,
    Receipt,
    Result,
    SubmissionReceipt,
    WinningEntry,
    team_commitment,
)
from vitac.server.transparency.merkle import Tree, make_tree
from vitac.server.transparency.notes import OF_WITNESS, Checkpoint, VerifierKey, cosign, sign_checkpoint
from vitac.server.views.leaderboards import LeaderboardEntryView, LeaderboardView

TASK = "peg-insertion"
VERSION = "1.0+abcdef"


def a_named_result(number: int, team: str = "Ants", successes: int = 100, **changes: Any) -> Result:
    """The result of a team in one task."""
    plain = a_result(number)
    reached = {"successes": successes, "success_rate": successes / 270, "mean_steps": changes.pop("steps", 4.0)}
    task = plain.tasks[0].model_copy(update=reached)
    return plain.model_copy(update={"tasks": (task,), "team_sha256": team_commitment(plain.salt, team), **changes})


def chained(*results: Result) -> list[Receipt]:
    """The receipts of results, one after the other."""
    return [receipt_for(result, number=number) for number, result in enumerate(results, start=1)]


def tree_of(receipts: list[Receipt]) -> Tree:
    """The log of receipts."""
    return make_tree([receipt.entry.leaf_hash for receipt in receipts])


def signed(receipts: list[Receipt]) -> Checkpoint:
    """What the service signs of the log of receipts."""
    return sign_checkpoint(KEY, size=len(receipts), root=tree_of(receipts).root())


def an_entry(result: Result, team: str = "Ants", rank: int | None = 1) -> LeaderboardEntryView:
    task = result.tasks[0]
    return LeaderboardEntryView(
        rank=rank,
        rank_range=None,
        stale=False,
        team=team,
        evaluation_id=result.evaluation,
        submission_id=result.submission,
        submission_name="zero",
        kind=SubmissionKind.MODEL,
        submitted_at=result.submitted_at,
        evaluated_at=result.finished_at,
        episodes=task.episodes,
        successes=task.successes,
        success_rate=task.success_rate,
        success_rate_interval=(0, 1),
        mean_steps=task.mean_steps,
        scores=[],
        result_hash=task.result_hash,
        evaluator_version=VERSION,
        list_kind=ListKind.PUBLIC,
    )


def exported(
    receipts: list[Receipt], *entries: LeaderboardEntryView, teams: dict[str, list[int]] | None = None, **changes: Any
) -> ExportDescription:
    """An export of the board of a task; all results are of the Ants where no teams are given."""
    board = LeaderboardView(
        track="track_1",
        title="Track 1",
        tasks=[TASK],
        task=TASK,
        stage=None,
        frozen_at=None,
        list_kind=ListKind.PUBLIC,
        ranking_rule="-",
        evaluator_version=VERSION,
        revision="1",
        generated_at=WHEN,
        teams=len(entries),
        entries=list(entries),
    )
    given = teams or {"Ants": [receipt.entry.number for receipt in receipts]}
    values: dict[str, Any] = {
        "made_at": WHEN,
        "public_key": PUBLIC_KEY,
        "secret": None,
        "commitment": None,
        "competition": "",
        "board": board,
        "kind": SubmissionKind.MODEL,
        "checkpoint": str(signed(receipts)),
        "teams": tuple(
            ExportedTeam(name=name, evaluations=tuple(UUID(int=number) for number in numbers))
            for name, numbers in given.items()
        ),
        "set_aside": (),
        "copies": (),
        "winners": (),
        "judged": (),
    }
    return ExportDescription(**(values | changes))


def by_evaluation(receipts: list[Receipt]) -> dict[UUID, Receipt]:
    return {receipt.result.evaluation: receipt for receipt in receipts}


@pytest.mark.parametrize(
    ("changes", "is_found"),
    [
        ({"successes": 101}, True),
        ({"steps": 3.0}, True),
        ({"submitted_at": WHEN - timedelta(seconds=1)}, True),
        ({}, False),
        ({"successes": 99}, False),
        ({"steps": None}, False),
        ({"successes": 200, "evaluator_version": "0.9+0"}, False),
        ({"successes": 200, "submission": a_result(2).submission}, True),
    ],
)
def test_a_result_that_is_better_than_its_teams_entry_is_found(changes: dict[str, Any], is_found: bool) -> None:
    """Also of a submission that was evaluated again, but not one of another evaluator version."""
    shown = a_named_result(2)
    receipts = chained(a_named_result(1, **changes), shown)
    described = exported(receipts, an_entry(shown))
    found = list(check_entries(described, by_evaluation(receipts)))
    expected = (True, "Ants: receipt 1 is better than its entry on the board.")
    assert found == ([expected] if is_found else [])


def test_a_result_of_a_disqualified_submission_is_told_and_is_no_finding() -> None:
    results = [a_named_result(1, successes=200), a_named_result(2)]
    receipts = chained(*results)
    teams = (ExportedTeam(name="Ants", evaluations=(UUID(int=1), UUID(int=2)), disqualified=(UUID(int=1),)),)
    described = exported(receipts, an_entry(results[1])).model_copy(update={"teams": teams})
    assert list(check_entries(described, by_evaluation(receipts))) == [
        (False, "Ants: receipt 1; the service leaves the result out: its submission was disqualified or withdrawn.")
    ]


def test_what_the_service_says_a_rejudgement_took_away_is_told_and_is_no_finding() -> None:
    results = [a_named_result(1, successes=200), a_named_result(2), a_named_result(3, team="Bees")]
    receipts, teams = chained(*results), {"Ants": [1, 2], "Bees": [3]}
    described = exported(receipts, an_entry(results[1]), teams=teams, set_aside=(UUID(int=1), UUID(int=3)))
    why = "; the service says that a rejudgement took it away."
    assert list(check_entries(described, by_evaluation(receipts))) == [
        (False, f"Ants: receipt 1 is better than its entry on the board{why}"),
        (False, f"Bees: receipt 3 is of this board, but the team is not on it{why}"),
    ]
    untold = exported(receipts, an_entry(results[1]), teams=teams, set_aside=(UUID(int=2),))
    assert [is_wrong for is_wrong, _ in check_entries(untold, by_evaluation(receipts))] == [True, True]


def test_a_copy_is_proven_by_an_earlier_receipt_of_another_team_with_the_same_result_hash() -> None:
    """What no receipt proves is told as the service's word; the earlier one of the two is nobody's copy."""
    first, copied = a_named_result(1), a_named_result(2, team="Bees", submitted_at=WHEN + timedelta(hours=1))
    partly = a_named_result(3, team="Bees", submitted_at=WHEN + timedelta(hours=2))
    other_hash = partly.tasks[0].model_copy(update={"result_hash": "e" * 64})
    partly = partly.model_copy(update={"tasks": (other_hash,)})
    teams, told = {"Ants": [1], "Bees": [2, 3]}, "; the service says that this is a copy of an earlier one"

    def unproven(*copies: int, teams: dict[str, list[int]] = teams) -> list[tuple[bool, str]]:
        receipts = chained(first, copied, partly)
        named = tuple(UUID(int=number) for number in copies)
        described = exported(receipts, an_entry(first), teams=teams, copies=named, kind=SubmissionKind.LOG)
        return [one for one in check_entries(described, by_evaluation(receipts)) if told in one[1]]

    assert unproven(2) == []
    assert unproven(2, 3) == [(False, f"Bees: receipt 3{told}, so it is not ranked.")]
    assert unproven(1) == [(False, f"Ants: receipt 1{told}, so it is not ranked.")], "the earlier one is no copy"
    own = unproven(2, teams={"Ants": [1, 2], "Bees": [3]})
    assert own == [(False, f"Ants: receipt 2{told}, so it is not ranked.")], "a team does not copy itself"
    assert unproven(2, teams={"Bees": [2, 3]}) != [], "a receipt that is given to no team proves nothing"


def test_copies_are_not_ranked_on_boards_of_either_kind() -> None:
    results = [a_named_result(1, successes=200), a_named_result(2)]
    receipts = chained(*results)
    said = (UUID(int=1),)
    for kind in (SubmissionKind.LOG, SubmissionKind.MODEL):
        board = exported(receipts, an_entry(results[1]), kind=kind, copies=said)
        assert list(check_entries(board, by_evaluation(receipts))) == [
            (False, "Ants: receipt 1; the service says that this is a copy of an earlier one, so it is not ranked.")
        ]
        unranked = exported(receipts[1:], an_entry(results[1], rank=None), kind=kind, copies=(UUID(int=2),))
        assert not [sentence for is_wrong, sentence in check_entries(unranked, {}) if is_wrong]


def test_a_result_of_another_task_is_not_missed() -> None:
    receipts = chained(a_named_result(1))
    other = exported(receipts).model_copy(
        update={"board": exported(receipts).board.model_copy(update={"task": "other"})}
    )
    assert list(check_entries(other, by_evaluation(receipts))) == []
    missing = list(check_entries(exported(receipts), by_evaluation(receipts)))
    assert missing == [(True, "Ants: receipt 1 is of this board, but the team is not on it.")]


def test_an_entry_that_is_given_to_two_teams_is_found() -> None:
    receipts = chained(a_named_result(1))
    described = exported(receipts, an_entry(receipts[0].result, team="Bees"), teams={"Ants": [1]})
    assert (True, "Bees: the export gives its result to Ants.") in list(
        check_entries(described, by_evaluation(receipts))
    )


def test_a_receipt_is_of_the_team_whose_name_it_was_issued_to() -> None:
    receipts = chained(a_named_result(1), a_named_result(2, team="Bees"))
    right = exported(receipts, teams={"Ants": [1], "Bees": [2]})
    assert list(check_teams(right, by_evaluation(receipts))) == []
    swapped = exported(receipts, teams={"Ants": [2], "Bees": [1]})
    assert [is_wrong for is_wrong, _ in check_teams(swapped, by_evaluation(receipts))] == [True, True]
    nobody = exported(receipts, teams={"Ants": [1]})
    assert list(check_teams(nobody, by_evaluation(receipts))) == [
        (True, "Receipt 2 is of a result that the export gives to no team.")
    ]


def test_an_entry_of_the_board_without_its_receipt_is_found() -> None:
    receipts = chained(a_named_result(1), a_named_result(2), a_named_result(3, track="track_2"))
    chain = {receipt.entry.number: receipt.entry for receipt in receipts}
    described = exported(receipts)
    assert list(check_opened(described, chain, receipts)) == []
    assert list(check_opened(described, chain, receipts[:1])) == [
        "Receipt 2 is of this board, but the export does not hold it."
    ], "the third one is of another track"


def test_the_log_is_compared_with_what_was_signed_and_noted() -> None:
    receipts = chained(a_named_result(1), a_named_result(2))
    tree, described = tree_of(receipts), exported(receipts)
    assert list(check_head(described, tree)) == []
    assert "Expected 2 entries in the log with the root" in next(check_head(described, tree_of(receipts[:1])))
    other = described.model_copy(update={"public_key": "0" * 64})
    assert "of another log" in next(check_head(other, tree))
    assert list(check_noted(tree, 1, tree.root(1).hex())) == list(check_noted(tree, 2, tree.root().hex())) == []
    assert "the log was rewritten" in next(check_noted(tree, 1, tree.root(2).hex()))
    assert "the log ends before" in next(check_noted(tree, 3, tree.root().hex()))


def arrived(result: Result, number: int = 1, **changes: Any) -> dict[UUID, SubmissionReceipt]:
    return {result.submission: arrival_of(result, number=number, **changes)}


def followed(result: Result, arrivals: dict[UUID, SubmissionReceipt], number: int = 2) -> list[tuple[bool, str]]:
    return list(check_submissions(arrivals, [receipt_for(result, number=number)]))


def test_a_result_follows_from_a_submission_that_arrived_before_it() -> None:
    result = a_named_result(1)
    assert followed(result, arrived(result)) == []
    ((is_wrong, sentence),) = followed(result, {})
    assert is_wrong
    assert "whose arrival has no receipt" in sentence
    ((is_wrong, sentence),) = followed(result, arrived(result, number=3))
    assert is_wrong
    assert "arrived later, with receipt 3" in sentence


@pytest.mark.parametrize(
    "changes",
    [
        {"submission_digest": "cd" * 32},
        {"competition": "last-year"},
        {"track": "track_2"},
        {"stage": "final"},
        {"kind": SubmissionKind.LOG},
        {"submitted_at": WHEN - timedelta(hours=1)},
    ],
)
def test_a_result_says_of_its_submission_what_was_signed_at_its_arrival(changes: dict[str, Any]) -> None:
    result = a_named_result(1)
    ((is_wrong, sentence),) = followed(result, arrived(result, **changes))
    assert is_wrong
    assert next(iter(changes)).replace("_", " ") in sentence


def test_a_first_result_long_after_its_submission_is_unusual_and_that_of_a_later_run_is_not() -> None:
    late = a_named_result(1, issued_at=WHEN + timedelta(days=3))
    assert followed(late, arrived(late, issued_at=WHEN)) == [
        (False, "Receipt 2: its result was issued 3 days after the submission; ask why.")
    ]
    again = late.model_copy(update={"run": 2})
    noted = followed(again, arrived(again, issued_at=WHEN))
    assert len(noted) == 1, "its number of runs is what the service says"
    first = a_named_result(2, submission=late.submission)
    both = [receipt_for(first, number=2), receipt_for(again, number=3)]
    assert list(check_submissions(arrived(first, issued_at=WHEN), both)) == []


@pytest.mark.parametrize(("minutes", "is_found"), [(0, False), (9, False), (11, True), (-1, True)])
def test_the_receipt_of_an_arrival_is_issued_when_the_submission_arrives(minutes: int, is_found: bool) -> None:
    receipts = arrived(a_named_result(1), issued_at=WHEN + timedelta(minutes=minutes))
    assert bool(list(check_arrivals(exported([]), receipts))) is is_found


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, None),
        ({"submission_digest": "cd" * 32}, "its submission digest is not that of the chosen one"),
        ({"submitted_at": WHEN - timedelta(days=1)}, "its submitted at is not that of the chosen one"),
        ({"stage": "stage2.final"}, "its stage is not that of the chosen one"),
        ({"team_sha256": team_commitment("0" * 32, "Bees")}, "not clearly of the same team"),
        ({"final_of": UUID(int=7)}, "has no receipt before it"),
    ],
)
def test_what_plays_a_final_list_arrived_before_as_the_one_that_was_chosen(
    changes: dict[str, Any], said: str | None
) -> None:
    result = a_named_result(1, stage="stage1")
    chosen = arrival_of(result, number=1)
    final = {"submission": UUID(int=9), "stage": "stage1.final", "final_of": result.submission}
    issued_at = WHEN + timedelta(days=30)
    copy = arrival_of(result, number=2, **(final | {"issued_at": issued_at} | changes))
    arrivals = {receipt.submission.submission: receipt for receipt in (chosen, copy)}
    found = list(check_arrivals(exported([], teams={"Ants": []}), arrivals))
    assert [(said or "") in sentence for sentence in found] == ([] if said is None else [True])


def test_entries_are_issued_one_after_the_other() -> None:
    later = WHEN + timedelta(seconds=1)
    in_order = chained(a_named_result(1), a_named_result(2), a_named_result(3, issued_at=later))
    assert list(check_order(receipt.entry for receipt in in_order)) == []
    backdated = chained(a_named_result(1, issued_at=later), a_named_result(2))
    assert len(list(check_order(receipt.entry for receipt in backdated))) == 1


def test_results_of_another_list_than_the_published_one_are_found() -> None:
    result = a_named_result(1, commitment="1" * 64)
    secret = "2" * 64
    fits = make_commitment(bytes.fromhex(secret))
    described = exported(chained(result), secret=secret, commitment=fits)
    assert list(check_secret(described, [result])) == [
        f"Results were played on a list with the commitment {'1' * 64}, the published secret has {fits}."
    ]
    assert list(check_secret(described, [a_named_result(1, commitment=fits)])) == []
    assert list(check_secret(exported(chained(result)), [result])) == [], "not published yet"


def an_end(winners: list[Result], marks: dict[UUID, float] | None = None) -> EndReceipt:
    end = End(
        issued_at=WHEN,
        competition="vitac",
        finalized_at=WHEN,
        reason=None,
        winners=tuple(
            WinningEntry(
                track="track_1",
                place=f"place {rank}",
                rank=rank,
                team="Ants",
                amount=100 // rank,
                currency="EUR",
                submission=result.submission,
                result_hash=result.result_hash,
                total=None,
            )
            for rank, result in enumerate(winners, start=1)
        ),
        judged=tuple(
            JudgedEntry(track="track_1", team="Ants", submission=submission, criteria={"idea": total}, total=total)
            for submission, total in (marks or {}).items()
        ),
    )
    return EndReceipt(entry=end.entry(9), public_key=PUBLIC_KEY, proofs=prove(end, 9), end=end)


def test_winners_prizes_and_marks_are_those_that_were_signed() -> None:
    first, second = a_named_result(1, successes=200), a_named_result(2, team="Bees")
    signed = an_end([first, second])
    entries = [an_entry(first), an_entry(second, "Bees", rank=2)]

    def found(**changes: Any) -> list[str]:
        values = {"winners": signed.end.winners, "judged": ()} | changes
        described = exported(chained(first, second), *entries, teams={"Ants": [1], "Bees": [2]}, **values)
        whole = described.model_copy(update={"board": described.board.model_copy(update={"task": None})})
        wrong = [sentence for is_wrong, sentence in check_winners(whole, chained(first, second)) if is_wrong]
        return [*check_end(whole, [signed]), *wrong]

    assert found() == []
    other_prize = signed.end.winners[0].model_copy(update={"amount": 1000})
    assert found(winners=(other_prize, signed.end.winners[1])) == [
        "The winners and prizes of the export are not those of receipt 9."
    ]
    swapped = an_end([second, first]).end.winners
    assert found(winners=swapped)[1:] == ["The winners are not the first ones of the board."]
    marks = an_end([first], {second.submission: 10.0}).end.judged
    assert found(judged=marks)[0] == "The judges' marks of the export are not those of receipt 9."


def test_winners_without_a_signed_end_are_found_and_those_of_a_judged_track_follow_its_totals() -> None:
    first, second = a_named_result(1, successes=200), a_named_result(2, team="Bees")
    judged = an_end([second, first], {first.submission: 5.0, second.submission: 6.0})
    board = exported(
        chained(first, second),
        an_entry(first),
        an_entry(second, "Bees", rank=2),
        teams={"Ants": [1], "Bees": [2]},
        winners=judged.end.winners,
        judged=judged.end.judged,
    )
    described = board.model_copy(update={"board": board.board.model_copy(update={"task": None})})
    assert list(check_end(described, [judged])) == []
    assert list(check_winners(described, chained(first, second))) == []
    assert "which has no end of the competition" in next(check_end(described, []))


def test_an_end_that_the_holder_of_the_key_signs_again_is_unusual_and_other_winners_in_it_are_found() -> None:
    first, second = a_named_result(1, successes=200), a_named_result(2, team="Bees")
    elsewhere = a_named_result(3, team="Cats")
    right = an_end([first, second])
    assert list(check_repeated_end([right])) == []
    assert list(check_repeated_end([right, right])) == ["Receipt 9: the end of vitac was signed again; ask why."]

    def of_board(*winners: Result, left_out: str | None = None) -> list[tuple[bool, str]]:
        described = exported(
            chained(first, second),
            an_entry(second, "Bees") if left_out else an_entry(first),
            *(() if left_out else (an_entry(second, "Bees", rank=2),)),
            teams={"Ants": [1], "Bees": [2]},
            winners=an_end(list(winners)).end.winners,
        )
        ants, bees = described.teams
        described = described.model_copy(
            update={
                "board": described.board.model_copy(update={"task": None}),
                "teams": (ants.model_copy(update={"off_boards": left_out}), bees),
            }
        )
        return list(check_winners(described, chained(first, second)))

    wrong = [(True, "The winners are not the first ones of the board.")]
    assert of_board(first, second) == []
    assert of_board(second) == wrong
    assert of_board(elsewhere, second) == wrong, "also where the first winner is not on the board"
    other_hash = second.model_copy(update={"result_hash": "0" * 64})
    assert of_board(first, other_hash) == wrong
    ((is_wrong, sentence),) = of_board(elsewhere)
    assert not is_wrong
    assert "audit the board of its last stage" in sentence
    ((is_wrong, sentence),) = of_board(first, second, left_out="disqualified, two accounts")
    assert not is_wrong
    assert sentence == "Ants: wins place 1; the service leaves the team out: disqualified, two accounts."


def test_a_log_that_the_demanded_witnesses_have_not_signed_is_found_although_it_fits() -> None:
    witness = VerifierKey(name="ants.example/v", kind=OF_WITNESS, public_key=bytes.fromhex(PUBLIC_KEY))
    results = chained(a_named_result(1, competition="cup", stage="only"))
    entries = [apply_file(1, str(witness), demanded=1).entry(1), results[0].result.entry(2)]
    tree = make_tree([entry.leaf_hash for entry in entries])
    checkpoint = sign_checkpoint(KEY, size=2, root=tree.root())

    def found(*witnessed: Checkpoint, **changes: Any) -> list[str]:
        described = exported(results, competition="cup", witnesses=(str(witness),), checkpoint=str(checkpoint))
        board = described.board.model_copy(update={"stage": "only"})
        of_export = {"board": board, "witnessed": tuple(map(str, witnessed))} | changes
        return list(check_witnessed(described.model_copy(update=of_export), tree, entries))

    early = sign_checkpoint(KEY, size=1, root=tree.root(1))
    assert found(checkpoint.with_signatures([cosign(KEY, "ants.example/v", checkpoint, 1)])) == []
    too_few = "Expected 1 witnesses that have signed entry 2 of the log, the last one of this stage, got 0"
    assert [sentence.partition(":")[0] for sentence in found()] == [too_few]
    assert len(found(early.with_signatures([cosign(KEY, "ants.example/v", early, 1)]))) == 1
    assert "not those of the competition's file" in found(witnesses=())[0]
