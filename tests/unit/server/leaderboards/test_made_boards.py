"""A board is made once for a revision, out of the one before; without a database."""

import json
from datetime import UTC, datetime

import pytest
from vitac.evaluator.tracks import ListKind
from vitac.server.leaderboards import board_cache
from vitac.server.leaderboards.board_cache import MadeBoards, compute_revision
from vitac.server.views.leaderboards import LeaderboardView


def view(revision: str, title: str = "Track") -> LeaderboardView:
    return LeaderboardView(
        track="track_1",
        title=title,
        tasks=["peg-insertion"],
        task=None,
        stage=None,
        list_kind=ListKind.PUBLIC,
        frozen_at=None,
        ranking_rule="Most first.",
        evaluator_version="7+abc",
        revision=revision,
        generated_at=datetime(2025, 3, 1, tzinfo=UTC),
        teams=0,
        entries=[],
    )


class Maker:
    """Makes boards and remembers out of which."""

    def __init__(self) -> None:
        self.boards: MadeBoards[LeaderboardView] = MadeBoards()
        self.before: list[str | None] = []

    def get(self, board: str, revision: str) -> board_cache.MadeBoard[LeaderboardView]:
        def make(last: LeaderboardView | None) -> LeaderboardView:
            self.before.append(last.revision if last else None)
            return view(revision)

        return self.boards.get(board, revision, make)


def test_a_board_of_the_same_revision_is_the_one_that_was_made() -> None:
    maker = Maker()
    first = maker.get("a", "1")
    assert maker.get("a", "1") is first
    assert maker.before == [None]


def test_a_new_revision_is_made_out_of_the_last_one() -> None:
    maker = Maker()
    for revision in ("1", "2", "2", "1"):
        assert maker.get("a", revision).view.revision == revision
    assert maker.before == [None, "1", "2"]


def test_boards_are_kept_apart() -> None:
    maker = Maker()
    assert maker.get("a", "1") is not maker.get("b", "1")
    maker.get("a", "2")
    assert maker.before == [None, None, "1"]
    assert maker.get("b", "1").view.revision == "1"


def test_a_board_that_cannot_be_made_leaves_the_last_one() -> None:
    maker = Maker()
    first = maker.get("a", "1")

    def fail(_: LeaderboardView | None) -> LeaderboardView:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        maker.boards.get("a", "2", fail)
    assert maker.get("a", "1") is first


def test_the_body_is_the_view_as_json_and_made_once() -> None:
    board = Maker().get("a", "1")
    assert json.loads(board.body())["revision"] == "1"
    assert LeaderboardView.model_validate_json(board.body()) == board.view
    assert board.body() is board.body()


def test_a_revision_is_short_and_depends_on_every_entry_and_their_order() -> None:
    revisions = {
        compute_revision("board", []),
        compute_revision("another", []),
        compute_revision("board", ["a"]),
        compute_revision("board", ["a", "b"]),
        compute_revision("board", ["b", "a"]),
    }
    assert len(revisions) == 5
    assert {len(revision) for revision in revisions} == {32}
    assert compute_revision("board", iter(["a", "b"])) == compute_revision("board", ("a", "b"))


@pytest.mark.parametrize("name", ["read_release", "evaluator_version"])
def test_a_revision_changes_with_the_software(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = compute_revision("board", ["a"])
    monkeypatch.setattr(board_cache, name, lambda *_: "another")
    assert compute_revision("board", ["a"]) != before
