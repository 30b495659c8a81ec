import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from page_fixtures import TASK, a_submission, some_episodes
from PIL import Image
from vitac.server.db.states import EvaluationState
from vitac.server.errors import SettingsError
from vitac.server.views.submissions import SubmissionView
from vitac.web.sharing.preview import HEIGHT, WIDTH, checked_font, draw_preview

COMPLETED = a_submission("Gelbots", EvaluationState.COMPLETED, name="Soft touch")
EPISODES = some_episodes(TASK, 270)
DEJAVU = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
"""A font with accents and Greek, without CJK."""


def pixels(picture: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"))


def named(name: str, team: str = "Gelbots") -> SubmissionView:
    return COMPLETED.model_copy(
        update={"name": name, "team": COMPLETED.team.model_copy(update={"name": team}), "rank": None}
    )


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


@pytest.mark.parametrize("name", ["触覚", "é", "\N{RIGHT-TO-LEFT OVERRIDE}abc"])
def test_a_name_that_the_font_cannot_write_is_left_out_rather_than_drawn_as_boxes(name: str) -> None:
    without = draw_preview(named("", team=""), "Track 1", EPISODES)
    assert draw_preview(named(name, team=""), "Track 1", EPISODES) == without
    assert draw_preview(named("abc", team=""), "Track 1", EPISODES) != without


def test_the_longest_names_stay_left_of_the_episodes() -> None:
    wide = pixels(draw_preview(named("W" * 128, team="W" * 64), "Track 1", EPISODES))
    short = pixels(draw_preview(named("a", team="b"), "Track 1", EPISODES))
    assert (wide[:, 640:] == short[:, 640:]).all()
    assert (wide[:, :640] != short[:, :640]).any()


def test_a_thousand_episodes_fit() -> None:
    many = [end.model_copy(update={"episode": place}) for place, end in enumerate(EPISODES * 5)]
    shown = pixels(draw_preview(COMPLETED, "Track 1", many))
    assert (shown[-100:, WIDTH // 2 :] == shown[-1, -1]).all(), "nothing below the grid"


@pytest.mark.parametrize("name", ["Équipe", "Αφή", "Łódź"])
def test_another_font_writes_the_names_that_ours_cannot(name: str) -> None:
    without = draw_preview(named("", team=""), "Track 1", EPISODES, DEJAVU)
    assert draw_preview(named(name, team=""), "Track 1", EPISODES, DEJAVU) != without
    assert draw_preview(named("", team=name), "Track 1", EPISODES, DEJAVU) != without


def test_another_font_changes_nothing_where_ours_can_write_or_neither_can() -> None:
    for name in ("abc", "触覚", "é触"):
        assert draw_preview(named(name), "Track 1", [], DEJAVU) == draw_preview(named(name), "Track 1", [])
    wide = pixels(draw_preview(named("É" * 128), "Track 1", EPISODES, DEJAVU))
    assert (wide[:, 640:] == pixels(draw_preview(named("a"), "Track 1", EPISODES))[:, 640:]).all(), "it is cut off, too"


def test_a_font_file_that_is_none_is_refused(tmp_path: Path) -> None:
    assert checked_font(None) is None
    assert checked_font(DEJAVU) == DEJAVU
    other = tmp_path / "other.ttf"
    other.write_bytes(b"no font")
    for file in (other, tmp_path, tmp_path / "missing.ttf"):
        with pytest.raises(SettingsError, match=r"VITAC_PREVIEW_FONT is .*, expected a font file"):
            checked_font(file)
