import re

from page_fixtures import a_submission
from vitac.server.database.states import EvaluationState
from vitac.web.sharing.preview import cite

ADDRESS = "https://arena.example/submissions/1"


def test_names_what_was_scored_by_what_and_where() -> None:
    found = a_submission("Gelbots", EvaluationState.COMPLETED, name="Soft touch")
    cited = cite(found, "Track 1", ADDRESS)
    for part in ("Gelbots. Soft touch. ViTac Arena, Track 1, 2026.", "9f3b" * 16, "1+0123456789ab", ADDRESS):
        assert part in cited.plain
    assert cited.bibtex.startswith(f"@misc{{vitac_{found.id.hex[:12]},\n")
    assert re.findall(r"^  (\w+) +=", cited.bibtex, re.MULTILINE) == [
        "title", "author", "year", "howpublished", "note", "url",
    ]  # fmt: skip
    assert "Success rate" in cited.plain
    refuted = found.model_copy(update={"evaluation": found.evaluation.model_copy(update={"played": None})})
    assert "Success rate" not in cite(refuted, "Track 1", ADDRESS).plain


def test_names_cannot_leave_their_field() -> None:
    found = a_submission("50% & {more}_\\", EvaluationState.COMPLETED, name="a}, note = {#1$ ~^")
    bibtex = cite(found, "Track 1", ADDRESS).bibtex
    assert r"author       = {{50\% \& \{more\}\_\textbackslash{}}}" in bibtex
    assert r"title        = {{a\}, note = \{\#1\$ \textasciitilde{}\textasciicircum{}}}" in bibtex
    balance, depths = 0, []
    for character in re.sub(r"\\[{}]", "", bibtex):
        balance += {"{": 1, "}": -1}.get(character, 0)
        depths.append(balance)
    assert depths[-1] == 0
    assert min(depths[:-1]) >= 0
