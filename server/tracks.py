"""Tracks as the API and the pages show them, with the limits that submissions have to keep."""

from dataclasses import asdict

from vitac.evaluator.tracks import Track, list_tracks, load_track
from vitac.server.db.states import SubmissionKind
from vitac.server.settings import Settings
from vitac.server.views.views import TrackListView, TrackTaskView, TrackView


def track_views(settings: Settings) -> TrackListView:
    """All tracks."""
    return TrackListView(items=[track_view(load_track(name), settings) for name in list_tracks()])


def track_view(track: Track, settings: Settings) -> TrackView:
    """One track."""
    return TrackView(
        name=track.name,
        title=track.title,
        summary=track.summary,
        ranking_rule=track.ranking_rule,
        combination_rule=track.combination_rule,
        accepts=[SubmissionKind(kind.value) for kind in track.accepts],
        tasks=[
            TrackTaskView(
                name=name, title=task.title, env_id=task.env_id, episodes=len(task.episodes), max_steps=task.max_steps
            )
            for name, task in track.tasks.items()
        ],
        log_bytes=settings.log_bytes,
        limits=asdict(settings.limits),
    )
