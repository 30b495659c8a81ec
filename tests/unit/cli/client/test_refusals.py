import httpx
import pytest
from vitac.cli.client.refusals import HINTS, RequestRefused, refusal


def test_a_refusal_has_a_line_each_for_sentence_hint_and_request_id() -> None:
    answer = httpx.Response(
        404, json={"code": "not_found", "detail": "There is no such submission."}, headers={"x-request-id": "r-17"}
    )
    found = refusal(answer)
    assert (found.status, found.code, found.hint) == (404, "not_found", HINTS["not_found"])
    assert str(found).splitlines() == [
        "refused with status 404 (not_found): There is no such submission.",
        f"  hint: {HINTS['not_found']}",
        "  request id: r-17",
    ]


def test_without_hint_and_request_id_the_sentence_stands_alone() -> None:
    found = RequestRefused(status=418, code="teapot", detail="No coffee.", request_id=None)
    assert (str(found), found.hint) == ("refused with status 418 (teapot): No coffee.", None)


@pytest.mark.parametrize("body", [b"", b"<html>", b"null", b"5", b'"text"', b"[1]", b'[["code", "x"]]', b"\xff"])
def test_an_answer_that_is_no_problem_is_told_as_that_of_something_else(body: bytes) -> None:
    found = refusal(httpx.Response(502, content=body))
    assert found.code == "no_code"
    assert str(found).endswith("Bad Gateway; this may not be a ViTac Arena service")
