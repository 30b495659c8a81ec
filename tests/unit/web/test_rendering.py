import re
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import jinja2
import pytest
from seeded_site import words
from vitac.server.views.submissions import ArchiveContents, BlankAnswerView, ModelCardView
from vitac.web import rendering
from vitac.web.rendering import STATIC, Same, environment, static_url


@pytest.mark.parametrize(("fraction", "text"), [(0.0, "0.0 %"), (0.41481, "41.5 %"), (1.0, "100.0 %"), (None, "–")])
def test_writes_a_fraction_as_percentage(fraction: float | None, text: str) -> None:
    assert rendering.percent(fraction).replace("\N{NO-BREAK SPACE}", " ") == text


def test_writes_times_in_utc_with_a_machine_readable_value() -> None:
    in_berlin = datetime(2026, 11, 21, 1, 30, 5, tzinfo=timezone(timedelta(hours=1)))
    html = rendering.timestamp(in_berlin)
    assert 'datetime="2026-11-21T00:30:05Z"' in html
    assert ">2026-11-21 00:30 UTC</time>" in html
    assert rendering.timestamp(in_berlin.astimezone(UTC)) == html
    assert 'class="nowrap deadline"' in rendering.timestamp(in_berlin, is_deadline=True)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0 s"),
        (41.6, "42 s"),
        (59.7, "1 min 00 s"),
        (185, "3 min 05 s"),
        (7800, "2 h 10 min"),
        (-3, "0 s"),
        (None, "–"),
    ],
)
def test_writes_a_length_of_time(seconds: float | None, text: str) -> None:
    assert rendering.duration(seconds) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(59.4, "59 s"), (60, "1 min 00 s"), (3599.4, "59 min 59 s"), (3599.6, "1 h 00 min"), (90_000, "25 h 00 min")],
)
def test_a_length_of_time_changes_its_unit_after_rounding(seconds: float, text: str) -> None:
    assert rendering.duration(seconds) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.05, "within 50 ms"),
        (0.999, "within 999 ms"),
        (1, "within 1 s"),
        (120, "within 2 min 00 s"),
        (float("inf"), "beyond what is counted"),
        (None, "–"),
    ],
)
def test_writes_a_bound_on_times(seconds: float | None, text: str) -> None:
    assert rendering.within(seconds) == text


@pytest.mark.parametrize(("count", "text"), [(0, "0"), (999, "999"), (1000, "1 000"), (1_234_567, "1 234 567")])
def test_thousands_stand_apart(count: int, text: str) -> None:
    assert rendering.number(count) == text.replace(" ", "\N{NARROW NO-BREAK SPACE}")


def test_no_time_is_a_dash() -> None:
    assert rendering.timestamp(None) == "–"


def test_a_value_from_a_submission_is_escaped_in_a_page() -> None:
    template = environment().from_string("{{ value }} {{ value|quantity }} {{ value|words }} {{ value|short }}")
    assert template.render(value="<i>") == "&lt;i&gt; &lt;i&gt; &lt;i&gt; &lt;i&gt;"


@pytest.mark.parametrize(("fraction", "text"), [(0.5, "50.00%"), (-1.0, "0.00%"), (2.0, "100.00%"), (None, "0.00%")])
def test_positions_stay_inside_the_drawing(fraction: float | None, text: str) -> None:
    assert rendering.across(fraction) == text


def test_mean_steps_without_success_is_a_dash() -> None:
    assert rendering.steps(None) == "–"
    assert rendering.steps(4.9234) == "4.92"


def test_words_and_short_digests() -> None:
    assert rendering.words("not_converged") == "not converged"
    assert rendering.words("peg-insertion") == "peg insertion"
    assert rendering.short("0123456789abcdef") == "0123456789ab"
    assert rendering.short(None) == "–"


def test_backticks_become_code_and_everything_is_escaped() -> None:
    assert rendering.prose("use `<b>` or <i>") == "use <code>&lt;b&gt;</code> or &lt;i&gt;"


def test_static_address_changes_with_the_content_only() -> None:
    name, _, digest = static_url("arena.css").partition("?v=")
    assert name == "/static/arena.css"
    assert len(digest) == 12
    assert static_url("arena.css") == static_url("arena.css")


def test_an_undefined_name_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError):
        environment().from_string("{{ nobody }}").render()


def test_every_template_compiles() -> None:
    names = environment().list_templates()
    assert {"layout.html", "leaderboard.html", "submission_live.html", "teams/team.html"} <= set(names)
    for name in names:
        environment().get_template(name)


def test_pages_name_no_other_host() -> None:
    """Pages load nothing from elsewhere: no CDN, no font service. Mediabunny names its licence and standards."""
    hosts = r"https?://(www\.w3\.org|www\.webmproject\.org|mozilla\.org|aomediacodec\.github\.io)/"
    files = (*STATIC.iterdir(), *(STATIC.parent / "templates").rglob("*.html"))
    texts = [path.read_text() for path in files if path.suffix in {".css", ".html", ".js", ".svg"}]
    assert len(texts) > 40
    for text in texts:
        assert not re.findall("https?://", re.sub(hosts, "", text))


def test_templates_hold_no_inline_script_or_style() -> None:
    for path in (STATIC.parent / "templates").rglob("*.html"):
        html = path.read_text()
        assert " style=" not in html
        assert "<style" not in html
        assert " onclick=" not in html
        assert "<script>" not in html


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (True, "yes"),
        (False, "no"),
        (3, "3"),
        (0.000432198, "0.0004322"),
        ([1.0, [2.5]], "1, 2.5"),
        ("x", "x"),
    ],
)
def test_writes_a_value_of_an_info_with_four_figures(value: object, text: str) -> None:
    assert rendering.quantity(value) == text


def test_templates_are_those_of_the_start_whatever_becomes_of_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "people").mkdir()
    (tmp_path / "people" / "row.html").write_text("{{ name }}")
    (tmp_path / "notes.txt").write_text("no template")
    (tmp_path / "page.html").write_text("{% include 'people/row.html' %} · today", encoding="utf-8")
    latin = lambda file, encoding="latin-1": file.read_bytes().decode(encoding)  # noqa: E731 - as where LANG says so
    monkeypatch.setattr(Path, "read_text", latin)
    templates = rendering.read_templates(tmp_path)
    assert sorted(templates) == ["page.html", "people/row.html"]
    monkeypatch.setattr(rendering, "TEMPLATES", templates)
    jinja = rendering.environment.__wrapped__()
    (tmp_path / "page.html").write_text("{{ made_by_later_code }}")
    (tmp_path / "people" / "row.html").unlink()
    assert jinja.get_template("page.html").render(name="Gelbots") == "Gelbots · today"


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [(-5, "0 min"), (359, "5 min"), (3 * 3600 + 301, "3 h 05 min"), (26 * 3600, "1 day 2 h"), (1e6, "11 days 13 h")],
)
def test_the_time_until_an_instant_has_two_units(seconds: float, shown: str) -> None:
    assert rendering.remaining(seconds) == shown


def test_the_card_of_a_sensor_without_code_names_no_policy() -> None:
    contents = ArchiveContents(frameworks=[], code_bytes=0, weights_bytes=0)
    card = ModelCardView(
        name="dome", track="track_3", tasks=["sensor-standard"], observation_keys=None, control_modes={},
        archive_bytes=3700, contents=contents, policy_ms=None,
    )  # fmt: skip
    about = environment().get_template("about.html").make_module({"submission": {"description": None}})
    sensor = about.model_card(card)  # type: ignore[attr-defined]
    assert "Sensor without a policy" in sensor
    assert "Reads" not in sensor
    assert "Computes with" not in sensor
    coded = card.model_copy(update={"contents": contents.model_copy(update={"code_bytes": 900})})
    assert "<dt>Policy</dt>" in about.model_card(coded)  # type: ignore[attr-defined]
    far = BlankAnswerView(task="peg-insertion", answer_s=0.0123, low=-0.5, high=1.5)
    server = card.model_copy(update={"contents": contents.model_copy(update={"blank_answers": [far]})})
    text = words(about.model_card(server))  # type: ignore[attr-defined]
    assert "peg insertion in 12.3 ms, with numbers from -0.5 to 1.5; what is beyond [-1, 1] is clipped" in text


def test_a_part_of_a_page_is_rendered_once_for_each_key() -> None:
    entry, equal = ["a row"], ["a row"]
    template = environment().from_string(
        "{% for each in rows %}{% call kept(key(each)) %}{{ say(each[0]) }}{% endcall %}{% endfor %}"
    )
    said: list[str] = []

    def say(text: str) -> str:
        said.append(text)
        return f"<{text}>"

    html = template.render(rows=[entry, entry, equal], key=lambda each: ("test", Same(each)), say=say)
    assert html == 3 * "&lt;a row&gt;"
    assert said == ["a row"] * 2, "another object is another row, whatever is in it"
