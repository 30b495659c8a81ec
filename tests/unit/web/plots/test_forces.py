"""The force on the held part of every episode, by whether it was solved."""

from page_fixtures import TASK
from recorded_forces import some_forces
from vitac.server.views.submissions import EpisodeView
from vitac.web.plots.draws import peak_forces


def an_end(number: int, peak_n: float | None, success: bool) -> EpisodeView:
    return EpisodeView(
        task=TASK,
        episode=number,
        shape="cuboid",
        initial_offset=(float(number), 0.0, 0.0),
        outcome="success" if success else "tactile",
        success=success,
        env_steps=4,
        forces=None if peak_n is None else some_forces(peak_n, events=int(peak_n > 40)),
    )


def test_every_episode_is_a_dot_beside_the_median_of_its_group() -> None:
    ends = [an_end(1, 10.0, True), an_end(2, 20.0, True), an_end(3, 50.0, False), an_end(4, None, False)]
    figure = peak_forces(TASK, ends)
    assert figure is not None
    assert figure.drawing.count("<circle") == 3
    assert figure.drawing.count('class="median"') == 2
    assert "solved 15.0 N, not solved 50.0 N. Dashed: 40 N." in figure.summary
    assert figure.table.rows[0] == ("On the held part, solved", "2", "15.0", "7.5", "1.5")
    assert figure.table.rows[3] == ("1 times above 40 N on the held part", "1", "", "", "")


def test_there_is_no_plot_without_recorded_forces() -> None:
    assert peak_forces(TASK, [an_end(1, None, True)]) is None
