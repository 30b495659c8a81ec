import httpx
import pytest
from vitac.cli.client.answers import HINTS, AnswerNotUnderstood, RequestRefused, decode, decode_object, pick, refusal
from vitac.cli.compare import EndedEpisode


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


def answered(content: str) -> httpx.Response:
    return httpx.Response(200, text=content, request=httpx.Request("GET", "http://a.test/api/v1/me"))


def test_a_key_that_an_older_service_does_not_send_is_named_however_deep() -> None:
    (episode,) = decode(answered('[{"task": "peg-insertion", "episode": 1, "new": {"a": 1}}]'))
    assert (episode["task"], episode["new"]["a"], episode.get("shape")) == ("peg-insertion", 1, None)
    for read in (lambda: episode["new"]["b"], lambda: pick(EndedEpisode, episode)):
        with pytest.raises(AnswerNotUnderstood, match=r"Expected '(b|shape)' in the service's answer, got .*release"):
            read()


@pytest.mark.parametrize("content", ["", "<html>", "[]", "null", "5", '{"a": '])
def test_what_is_no_object_comes_from_something_else(content: str) -> None:
    with pytest.raises(AnswerNotUnderstood, match=r"http://a.test/api/v1/me, got .* check --server"):
        decode_object(answered(content))
