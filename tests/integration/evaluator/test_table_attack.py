"""A table of another team's actions, changed a little: worth nothing on a sealed list, and found."""

from dataclasses import replace

import numpy as np
import pytest
from policies.table_attack import CHANGE, SECRET, TASK, Table, changed, improve, likeness, play, policies, rate
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.sealed import sealed_track

EPISODES = slice(0, 12)


@pytest.mark.slow
def test_a_table_of_published_actions_ends_below_its_source_on_a_sealed_list_and_is_found() -> None:
    track = load_track("track_1")
    public, sealed = (each.tasks[TASK] for each in (track, sealed_track(track, SECRET)))
    source = dict(policies(public, 0))["trained"]
    published = play(public, public.episodes[EPISODES], source)
    rng = np.random.default_rng(0)
    rows = [replace(row, actions=changed(row.actions, CHANGE, rng)) for row in published]
    on_sealed = rate(play(sealed, sealed.episodes[EPISODES], source))
    for table in (rows, improve(public, public.episodes[EPISODES], rows, 2.0, rng)):
        on_public = play(public, public.episodes[EPISODES], Table(table).begin)
        assert likeness(published, on_public).is_copy
        assert rate(play(sealed, sealed.episodes[EPISODES], Table(table).begin)) < on_sealed
    assert rate(published) > 0.5, "the source is good enough to be worth copying"
