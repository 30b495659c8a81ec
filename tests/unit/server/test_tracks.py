"""Tracks as the service shows them, and the refusals of those that are not there; without a database."""

import pytest
from service_factories import make_settings
from vitac.evaluator.tracks import list_tracks, load_track
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.tracks import known_task, known_track, load_known_track, require_task, track_view, track_views


@pytest.mark.parametrize("name", list_tracks())
def test_a_known_track_is_the_evaluators(name: str) -> None:
    assert load_known_track(name) is load_track(name)


@pytest.mark.parametrize("name", ["", "track_9", "../track_1", "TRACK_1"])
def test_an_unknown_track_is_refused_with_those_that_there_are(name: str) -> None:
    with pytest.raises(ServiceError) as refused:
        load_known_track(name)
    assert refused.value.code is ProblemCode.UNKNOWN_TRACK
    assert refused.value.extras == {"tracks": list(list_tracks())}
    assert refused.value.detail == f"There is no track {name!r}; the tracks are {', '.join(list_tracks())}."


def test_an_unknown_task_is_refused_with_the_tracks_own() -> None:
    track = load_track("track_1")
    for task in track.tasks:
        require_task(track, task)
    with pytest.raises(ServiceError) as refused:
        require_task(track, "fusion-insertion")
    assert refused.value.code is ProblemCode.UNKNOWN_TASK
    assert refused.value.extras == {"tasks": list(track.tasks)}
    assert refused.value.detail == (
        f"Track 'track_1' has no task 'fusion-insertion'; its tasks are {', '.join(track.tasks)}."
    )


def test_what_a_submission_has_kept_of_a_removed_track_is_not_known() -> None:
    assert known_track("track_1") is load_track("track_1")
    assert known_task("track_1", "peg-insertion") is load_track("track_1").tasks["peg-insertion"]
    assert known_track("gone") is None
    assert [known_task("gone", "peg-insertion"), known_task("track_1", "gone")] == [None, None]


def test_all_tracks_are_shown() -> None:
    views = track_views(make_settings()).items
    assert [view.name for view in views] == list(list_tracks())


@pytest.mark.parametrize("name", list_tracks())
def test_a_track_is_shown_with_its_rules_tasks_and_limits(name: str) -> None:
    track, settings = load_track(name), make_settings(log_bytes=12345)
    view = track_view(track, settings)
    assert (view.title, view.summary) == (track.title, track.summary)
    assert (view.ranking_rule, view.combination_rule) == (track.ranking_rule, track.combination_rule)
    assert view.accepts == list(track.accepts)
    assert [(task.name, task.episodes, task.max_steps, task.env_id) for task in view.tasks] == [
        (name, len(task.episodes), task.max_steps, task.env_id) for name, task in track.tasks.items()
    ]
    assert view.log_bytes == 12345
    assert view.limits["memory_bytes"] == settings.limits.memory_bytes
