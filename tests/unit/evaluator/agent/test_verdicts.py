import pytest
from vitac.errors import VitacError
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode


@pytest.mark.parametrize("code", VerdictCode)
def test_every_verdict_has_a_sentence(code: VerdictCode) -> None:
    assert code.sentence.endswith(".")
    assert len(code.sentence) > 30


def test_failure_carries_what_its_team_needs() -> None:
    failure = PolicyFailed(VerdictCode.CRASHED, "act() raised", "Traceback")
    assert isinstance(failure, VitacError)
    assert (failure.verdict, failure.message, failure.output_tail) == (VerdictCode.CRASHED, "act() raised", "Traceback")
    assert str(failure) == "crashed: act() raised"


def test_a_missing_package_is_named_with_how_it_comes_with_the_submission() -> None:
    said = VerdictCode.IMPORT_ERROR.explain("ModuleNotFoundError: No module named 'scipy.optimize'")
    assert said.startswith(VerdictCode.IMPORT_ERROR.sentence)
    assert "If scipy is of another one" in said
    assert "pip install --target FOLDER --only-binary :all: --no-deps PACKAGE" in said
    for other in ("No module named 'torch'", "SyntaxError: invalid syntax"):
        assert VerdictCode.IMPORT_ERROR.explain(other) == VerdictCode.IMPORT_ERROR.sentence
