import pytest
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import load_track
from vitac.server.views.submissions import EpisodeView
from vitac.web.plots.map import MapCell, describe_start, episode_map

FOLDER = "/submissions/1/episodes/peg-insertion"
TASK = load_track("track_1").tasks["peg-insertion"]

START = ", start x −4.00 mm, y −4.00 mm, turned −8.00°"


@pytest.mark.parametrize(
    ("track", "task", "offset", "words"),
    [
        ("track_1", "peg-insertion", (1.0, -2.0, 3.0), "x +1.00 mm, y −2.00 mm, turned +3.00°"),
        ("explore", "explore", (1.0, -2.0, 3.0), "x +1.00 mm, y −2.00 mm, turned +3.00°"),
        ("in_hand_turn", "in-hand-turn", (0.5, -8.0, 14.0), "gap +0.50 mm, rod at −8.00°, goal +14.00°"),
        ("slip", "slip", (1.5, 3.0), "x +1.50 mm, z +3.00 mm"),
        ("moving_hole", "moving-hole", (4.0, -4.0, 8.0), "x +4.00 mm, y −4.00 mm, turned +8.00°"),
    ],
)
def test_a_start_is_described_by_what_its_numbers_are(
    track: str, task: str, offset: tuple[float, ...], words: str
) -> None:
    assert describe_start(load_track(track).tasks[task], offset) == words


def an_end(number: int, outcome: EpisodeOutcome, env_steps: int = 3) -> EpisodeView:
    success = outcome is EpisodeOutcome.SUCCESS
    return EpisodeView(
        task="peg-insertion",
        episode=number,
        shape="cuboid",
        initial_offset=(0.0,),
        outcome=outcome,
        success=success,
        env_steps=env_steps,
    )


def test_lays_starts_out_as_columns_and_repeats_as_rows() -> None:
    laid_out = episode_map("track_1", "peg-insertion", {}, folder=FOLDER)
    assert [shape.name for shape in laid_out.shapes] == ["cuboid", "trapezoid", "concave1"]
    for shape in laid_out.shapes:
        assert (shape.columns, shape.rows, shape.total) == (30, 3, 90)
        assert len({(cell.column, cell.row) for cell in shape.cells}) == 90


def test_every_episode_has_one_cell() -> None:
    labels = [
        cell.label
        for shape in episode_map("track_1", "peg-insertion", {}, folder=FOLDER).shapes
        for cell in shape.cells
    ]
    numbers = sorted(int(label.removeprefix("Episode ").partition(",")[0]) for label in labels)
    assert numbers == list(range(1, len(TASK.episodes) + 1))


def test_an_episode_that_has_not_run_waits() -> None:
    shape = episode_map("track_1", "peg-insertion", {}, folder=FOLDER).shapes[0]
    assert {cell.state for cell in shape.cells} == {"waiting"}
    assert (shape.done, shape.successes) == (0, 0)
    assert shape.cells[0].label.endswith("not run yet")


def test_shows_how_an_episode_ended() -> None:
    ends = {1: an_end(1, EpisodeOutcome.SUCCESS, 4), 2: an_end(2, EpisodeOutcome.TACTILE, 2)}
    laid_out = episode_map("track_1", "peg-insertion", ends, folder=FOLDER)
    cells = {cell.label: cell.state for shape in laid_out.shapes for cell in shape.cells if cell.state != "waiting"}
    assert cells == {
        f"Episode 1{START}: success at env step 4. The task was solved.": "success",
        f"Episode 2{START}: tactile at env step 2. The gel surface of a sensor moved too far.": "other",
    }
    counted = [(end.outcome, end.count, end.address) for end in laid_out.outcomes]
    assert counted == [("success", 1, f"{FOLDER}/1"), ("tactile", 1, f"{FOLDER}/2")]


def test_starts_of_another_list_are_not_named() -> None:
    ends = {1: an_end(1, EpisodeOutcome.SUCCESS, 4)}
    shape = episode_map("track_1", "peg-insertion", ends, folder=FOLDER, known=False).shapes[0]
    assert shape.cells[0].label == "Episode 1: success at env step 4. The task was solved."


@pytest.mark.parametrize("outcome", list(EpisodeOutcome))
def test_only_a_success_counts_as_success(outcome: EpisodeOutcome) -> None:
    ends = {episode.number: an_end(episode.number, outcome) for episode in TASK.episodes}
    shapes = episode_map("track_1", "peg-insertion", ends, folder=FOLDER).shapes
    assert sum(shape.successes for shape in shapes) == (270 if outcome is EpisodeOutcome.SUCCESS else 0)
    assert sum(shape.done for shape in shapes) == 270


def test_an_outcome_cannot_bring_markup_into_the_drawing() -> None:
    shape = episode_map("track_1", "peg-insertion", {1: an_end(1, EpisodeOutcome.STEPS)}, folder=FOLDER).shapes[0]
    hostile = MapCell(column=0, row=0, state="other", label="<script>")
    assert shape.drawing.count("<rect") == 90
    assert f"Episode 1{START}: steps at env step 3. All env steps were used up.</title>" in shape.drawing
    assert "<script>" not in hostile.drawing


def test_a_finished_episode_is_a_link_and_a_waiting_one_is_not() -> None:
    ends = {1: an_end(1, EpisodeOutcome.SUCCESS)}
    shape = episode_map("track_1", "peg-insertion", ends, folder=FOLDER).shapes[0]
    assert shape.is_linked
    assert shape.drawing.count("<a ") == 1
    assert '<a href="/submissions/1/episodes/peg-insertion/1"><title>Episode 1, start' in shape.drawing


def test_an_address_cannot_bring_markup_into_the_drawing() -> None:
    hostile = MapCell(column=0, row=0, state="other", label="x", address='"><script>')
    assert "<script>" not in hostile.drawing


def test_episodes_of_an_evaluation_that_has_ended_are_not_run_yet_for_ever() -> None:
    for has_ended, said in ((True, ": not run</title>"), (False, ": not run yet</title>")):
        shape = episode_map("track_1", "peg-insertion", {}, folder=FOLDER, has_ended=has_ended).shapes[0]
        assert said in shape.drawing
