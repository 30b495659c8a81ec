import pytest
from toy_peg import ToyPeg


@pytest.fixture(autouse=True)
def toy(monkeypatch: pytest.MonkeyPatch) -> list[ToyPeg]:
    """Puts ToyPeg in the place of the environment and gives those that were made."""
    made: list[ToyPeg] = []

    def make(**_: object) -> ToyPeg:
        made.append(ToyPeg())
        return made[-1]

    monkeypatch.setattr("vitac.training.collection.make_environment", make)
    monkeypatch.setattr("vitac.training.collection._ENVIRONMENTS", {})
    return made
