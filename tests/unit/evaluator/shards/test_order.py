"""Orders to a shard's process: what two of them have to have in common to share an environment and a policy."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import FailureStage, PolicyFailure
from vitac.evaluator.figures.figures import FigureChoice
from vitac.evaluator.isolation_kinds import IsolationKind
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.shards.order import PROCESS_ID, ShardMessage, ShardOrder, decode_waiting, encode_waiting
from vitac.evaluator.submission_kinds import SubmissionKind

FAILURE = PolicyFailure(
    stage=FailureStage.EPISODE, code=VerdictCode.CRASHED, message="It crashed.", output_tail="Traceback"
)
OWN = {
    "secret": Path("/secret"),
    "shard": 7,
    "episodes": (1, 2),
    "skip": (3,),
    "earlier_failures": (FAILURE,),
    "code": "0123456789ABCDEF",
    "attempt": 2,
    "coefficients": Coefficients(mesh_hash="0" * 64, starts=3, regressions=()),
}
"""What may differ between two orders that share."""
SHARED = {
    "kind": SubmissionKind.LOG,
    "submission": Path("/other"),
    "track": "track_2",
    "task": "lock-opening",
    "evaluator_version": "1+another",
    "limits": Limits(open_files=7),
    "assets_dir": Path("/assets"),
    "episode_period_s": 0.5,
    "isolation": IsolationKind.VM,
    "remote": "ws://127.0.0.1:8000",
    "sensor": Path("/sensor"),
    "figures": next(choice for choice in FigureChoice if choice is not FigureChoice.NONE),
}
"""What environment or policy depend on."""


def order(**changes: Any) -> ShardOrder:
    values = {
        "kind": SubmissionKind.MODEL, "submission": Path("/mine"), "track": "track_1", "task": "peg-insertion",
        "shard": 0,
    }  # fmt: skip
    return ShardOrder(**{**values, **changes})


@pytest.mark.parametrize("name", OWN)
def test_orders_of_other_episodes_share_what_was_prepared(name: str) -> None:
    assert order(**{name: OWN[name]}) != order()
    assert order(**{name: OWN[name]}).preparation() == order().preparation()


@pytest.mark.parametrize("name", SHARED)
def test_orders_of_another_environment_or_policy_share_nothing(name: str) -> None:
    assert order(**{name: SHARED[name]}).preparation() != order().preparation()


def test_every_field_is_of_one_of_the_two_kinds() -> None:
    assert {*OWN, *SHARED} == set(ShardOrder.model_fields)


def test_an_order_survives_its_way_to_the_process() -> None:
    whole = order(**{**OWN, **SHARED})
    assert ShardOrder.model_validate_json(whole.model_dump_json()) == whole


@pytest.mark.parametrize("change", [{"shard": -1}, {"task": None}, {"unknown": 1}])
def test_an_order_that_cannot_be_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        order(**change)


def test_a_message_says_one_thing_and_waiting_how_far_the_calibration_is() -> None:
    told = ShardMessage(error="It failed.").model_dump_json(exclude_none=True)
    assert told == '{"error":"It failed."}'
    assert decode_waiting(encode_waiting(17, 180)) == (17, 180)
    assert len(encode_waiting(0, 180)) == PROCESS_ID.size, "either is read as the first word"
