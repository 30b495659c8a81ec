import re
from collections import Counter

import pytest
from page_fixtures import LOCK, TASK, TASKS, a_score, some_episodes
from vitac.evaluator.tracks import load_track
from vitac.server.views.submissions import EpisodeView
from vitac.web.plots.axis import Figure
from vitac.web.plots.episodes import MAX_BARS, count_outcomes, offset_maps, steps_histogram, success_by_shape

ENDS = some_episodes(TASK, 270)


def maps_of(task: str, ends: list[EpisodeView], track: str = "track_1") -> list[Figure]:
    return offset_maps(track, task, {end.episode: end for end in ends})


def squares(figure: Figure) -> list[str]:
    return re.findall(r'class="outcome (\w+)"', figure.drawing)


def an_end(number: int, env_steps: int, outcome: str = "success") -> EpisodeView:
    return EpisodeView(
        task=TASK,
        episode=number,
        shape="cuboid",
        initial_offset=(0.0,),
        outcome=outcome,
        success=outcome == "success",
        env_steps=env_steps,
    )


def test_each_shape_has_a_map_with_a_slice_for_each_episode() -> None:
    figures = maps_of(TASK, ENDS)
    assert [figure.title for figure in figures] == ["Cuboid", "Trapezoid", "Concave1"]
    for figure, shape in zip(figures, TASKS[TASK].episode_list.shapes, strict=True):
        assert Counter(squares(figure)) == Counter(end.outcome for end in ENDS if end.shape == shape)
        assert figure.drawing.count("<g>") == len(figure.table.rows) == 30
        assert "x [mm]" in figure.drawing
        assert "y [mm]" in figure.drawing


def test_repeats_of_a_start_stand_side_by_side_in_their_order() -> None:
    first = TASKS[TASK].episodes[0]
    same = [e.number for e in TASKS[TASK].episodes if (e.shape, e.offset) == (first.shape, first.offset)]
    ends = [an_end(number, 4, outcome) for number, outcome in zip(same, ("tactile", "success", "steps"), strict=True)]
    [figure] = maps_of(TASK, ends)
    assert squares(figure) == ["tactile", "success", "steps"]
    places = [float(x) for x in re.findall(r'<rect [^>]*\bx="([\d.]+)"', figure.drawing)]
    assert places == sorted(places)
    assert figure.table.rows == (("x −4.00 mm, y −4.00 mm, turned −8.00°", "1 of 3", "tactile, success, steps"),)
    assert "1 of 3 episodes solved" in figure.summary


def test_offsets_along_one_direction_make_a_row() -> None:
    figures = maps_of(LOCK, some_episodes(LOCK, 160))
    assert len(figures) == 4
    for figure in figures:
        assert figure.height < 200
        assert len(set(re.findall(r'<rect [^>]*\by="([\d.]+)"', figure.drawing))) == 1


def test_all_squares_lie_inside_the_drawing() -> None:
    for figure in [*maps_of(TASK, ENDS), *maps_of(LOCK, some_episodes(LOCK, 160))]:
        for x, y in re.findall(r'<rect class="outcome \w+" x="([\d.-]+)" y="([\d.-]+)"', figure.drawing):
            assert 0 <= float(x) <= figure.width
            assert 0 <= float(y) <= figure.height


@pytest.mark.parametrize("track", ["track_2", "track_2_gt"])
def test_lists_with_more_numbers_in_a_start_are_drawn_too(track: str) -> None:
    name, task = next(iter(load_track(track).tasks.items()))
    ends = [
        EpisodeView(
            task=name,
            episode=each.number,
            shape=each.shape,
            initial_offset=each.offset,
            outcome="steps",
            success=False,
            env_steps=50,
        )
        for each in task.episodes
    ]
    assert sum(len(squares(figure)) for figure in maps_of(name, ends, track)) == 150


def test_nothing_played_has_no_map() -> None:
    assert maps_of(TASK, []) == []


def test_the_key_has_the_outcomes_that_occur() -> None:
    ends = [an_end(1, 3, "tactile"), an_end(2, 3), an_end(3, 3, "tactile")]
    assert count_outcomes(ends) == ["tactile", "success"]


def test_success_by_shape_has_rates_and_intervals() -> None:
    figure = success_by_shape(a_score((90, 45, 0), 4.0))
    centres = [float(x) for x in re.findall(r'class="point" cx="([\d.]+)"', figure.drawing)]
    assert centres == [560.0, 340.0, 120.0]
    bands = [
        (float(x), float(w))
        for x, w in re.findall(r'class="band" x="([\d.]+)" y="[\d.]+" width="([\d.]+)"', figure.drawing)
    ]
    assert all(x <= centre <= x + width + 0.01 for (x, width), centre in zip(bands, centres, strict=True))
    assert figure.table.rows[1][:2] == ("trapezoid", "45 of 90")


def test_histogram_counts_every_episode_once() -> None:
    ends = [an_end(1, 3), an_end(2, 3, "tactile"), an_end(3, 8), an_end(4, 0, "policy_failed")]
    figure = steps_histogram(TASK, ends)
    rows = {row[0]: row[1:] for row in figure.table.rows}
    assert (rows["3"], rows["8"], rows["0"], rows["5"]) == (("1", "1"), ("1", "0"), ("0", "1"), ("0", "0"))
    assert len(rows) == 9
    assert re.findall(r"<text [^>]*>([a-z ]+)</text>", figure.drawing) == ["episodes", "solved", "not solved"]
    titles = re.findall(r"<title>(.*?)</title>", figure.drawing)
    assert titles[:3] == [
        "0 env steps: 0 solved, 1 not",
        "1 env step: 0 solved, 0 not",
        "2 env steps: 0 solved, 0 not",
    ]


@pytest.mark.parametrize("most", [0, 1, 24, 25, 50, 1000])
def test_histogram_has_few_bars_whatever_the_number(most: int) -> None:
    figure = steps_histogram(TASK, [an_end(1, most), an_end(2, 0)])
    assert len(figure.table.rows) <= MAX_BARS
    assert sum(int(row[1]) for row in figure.table.rows) == 2
    heights = [float(height) for height in re.findall(r'class="bar \w+"[^>]* height="([\d.-]+)"', figure.drawing)]
    assert min(heights) >= 0
