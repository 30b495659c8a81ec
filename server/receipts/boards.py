"""Boards at the end of a competition as the log names them."""

import hashlib
from datetime import datetime

from vitac.evaluator.episodes.records import canonical_json

from ..transparency.entries import FinalBoard
from ..views.leaderboards import LeaderboardView

_FIELDS = ("rank", "submission_id", "evaluation_id", "success_rate", "mean_steps", "result_hash")


def hash_board(board: LeaderboardView) -> str:
    """Return the SHA-256 [hex] over what a board says of its entries, whatever names of teams it shows."""
    entries = [entry.model_dump(mode="json", include=set(_FIELDS)) for entry in board.entries]
    return hashlib.sha256(canonical_json({"entries": entries})).hexdigest()


def make_final_board(competition: str, board: LeaderboardView, at: datetime) -> FinalBoard:
    """Return what the log says of a board."""
    return FinalBoard(
        issued_at=at,
        competition=competition,
        track=board.track,
        stage=board.stage or "",
        entries=len(board.entries),
        board_sha256=hash_board(board),
    )
