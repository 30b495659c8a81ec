import io
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from page_fixtures import TASK, a_submission, some_episodes
from PIL import Image
from vitac.server.database.states import EvaluationState
from vitac.server.errors import ServiceSettingsError
from vitac.server.views.submissions import SubmissionView
from vitac.web import sharing
from vitac.web.sharing import HEIGHT, WIDTH, checked_font, cite, draw_preview

COMPLETED = a_submission("Gelbots", EvaluationState.COMPLETED, name="Soft touch")
EPISODES = some_episodes(TASK, 270)
DEJAVU = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
"""A font that also has Georgian, without CJK."""


def pixels(picture: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"))


def named(name: str, team: str = "Gelbots") -> SubmissionView:
    return COMPLETED.model_copy(
        update={"name": name, "team": COMPLETED.team.model_copy(update={"name": team}), "rank": None}
    )


def boxes(name: str, font_file: Path | None = None) -> int:
    """How many characters of a name no font has."""
    files = [file for file in (sharing._noto_sans(), font_file) if file is not None]
    return sum(not any(sharing._can_write(character, file) for file in files) for character in sharing._plain(name))


def drawn(shown: SubmissionView, track: str = "Track 1", font_file: Path | None = None) -> np.ndarray:
    """The picture without episodes."""
    return pixels(draw_preview(shown, track, [], font_file))


def test_is_a_small_picture_that_shows_each_episode() -> None:
    picture = draw_preview(COMPLETED, "Track 1", EPISODES)
    assert len(picture) < 60_000
    shown = pixels(picture)
    assert shown.shape == (HEIGHT, WIDTH, 3)
    bad = (shown[:, WIDTH // 2 :].astype(int) - (0xB0, 0x40, 0x1C)).__abs__().sum(axis=2) < 40
    failures = sum(not end.success for end in EPISODES)
    cell = bad.sum() / failures
    assert 150 < cell < 900, "each failure is a square of its own"
    assert draw_preview(COMPLETED, "Track 1", EPISODES) == picture


def test_where_episodes_are_not_shown_there_are_none() -> None:
    without = pixels(draw_preview(COMPLETED, "Track 1", []))
    assert not ((without.astype(int) - (0xB0, 0x40, 0x1C)).__abs__().sum(axis=2) < 40).any()
    assert (pixels(draw_preview(COMPLETED, "Track 1", EPISODES)) != without).any()


def test_names_with_accents_in_greek_and_cyrillic_are_written_as_they_are() -> None:
    for name in ("Équipe", "Zażółć gęślą jaźń", "Þórr Øst", "Αφή", "Команда Її", "e\N{COMBINING ACUTE ACCENT}"):
        assert boxes(name) == 0
    assert sharing._plain("e\N{COMBINING ACUTE ACCENT}") == "é"
    unassigned, private = "\U000e0fff", "\ue000"  # of no name in any version of Unicode, so boxes
    assert sharing._plain(f"a\u200b{unassigned}\n{private}") == f"a{unassigned} {private}"
    plain = drawn(named("Equipe"))
    assert (drawn(named("Équipe")) != plain).any()
    assert (drawn(named("Equipe", team="Αφή")) != plain).any()


def test_a_character_that_no_font_has_is_a_box() -> None:
    for name, missing in (("触覚", 2), ("é触", 1), ("abc 🙂 Ü", 1), ("触\u3000覚", 2)):
        assert boxes(name) == missing
    assert (drawn(named("a触")) != drawn(named("a"))).any()
    assert (drawn(named("a触")) == drawn(named("a覚"))).all()


def test_characters_that_show_nothing_are_left_out() -> None:
    for name in ("\N{RIGHT-TO-LEFT OVERRIDE}abc def", "ab\N{ZERO WIDTH SPACE}c def", "abc\N{NO-BREAK SPACE}def\x00"):
        assert sharing._plain(name) == "abc def"


@pytest.mark.parametrize("letters", ["W", "É", "W触"])
def test_the_longest_names_stay_left_of_the_episodes(letters: str) -> None:
    wide = pixels(draw_preview(named((letters * 128)[:128], team=(letters * 64)[:64]), "Track 1", EPISODES))
    short = pixels(draw_preview(named("a", team="b"), "Track 1", EPISODES))
    assert (wide[:, 640:] == short[:, 640:]).all()
    assert (wide[:, :640] != short[:, :640]).any()


def test_a_thousand_episodes_fit() -> None:
    many = [end.model_copy(update={"episode": place}) for place, end in enumerate(EPISODES * 5)]
    shown = pixels(draw_preview(COMPLETED, "Track 1", many))
    assert (shown[-100:, WIDTH // 2 :] == shown[-1, -1]).all(), "nothing below the grid"


def test_the_font_that_was_set_writes_what_ours_cannot() -> None:
    for name in ("ა", "abc ა", "é ა"):
        assert (boxes(name), boxes(name, DEJAVU)) == (1, 0)
    without = drawn(named("a", team="b"), "ა")
    for changed in (drawn(named("ა", team="b"), "ა", DEJAVU), drawn(named("a", team="b"), "ა", DEJAVU)):
        assert (changed != without).any()
    assert (drawn(named("Équipe", team="触"), "1", DEJAVU) == drawn(named("Équipe", team="触"), "1")).all()


def test_fonts_are_mixed_only_in_names_of_which_none_has_all_characters() -> None:
    ours, theirs = sharing._noto_sans(), DEJAVU
    assert list(sharing._runs("é ა", (ours, theirs))) == [("é ა", theirs)]
    assert list(sharing._runs("éა触 ა", (ours, theirs))) == [("é", ours), ("ა", theirs), ("触 ", ours), ("ა", theirs)]
    assert list(sharing._runs("", (ours, theirs))) == [("", ours)]


def test_a_font_file_that_is_none_is_refused(tmp_path: Path) -> None:
    assert checked_font(None) is None
    assert checked_font(DEJAVU) == DEJAVU
    other = tmp_path / "other.ttf"
    other.write_bytes(b"no font")
    for file in (other, tmp_path, tmp_path / "missing.ttf"):
        with pytest.raises(ServiceSettingsError, match=r"VITAC_PREVIEW_FONT is .*, expected a font file"):
            checked_font(file)


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
