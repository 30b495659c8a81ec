"""Success against what was drawn for each episode."""

import pytest
from vitac.evaluator.tracks import find_task
from vitac.server.views.submissions import EpisodeView
from vitac.web.plots.draws import success_by_draw

TASK = "peg-insertion-robust"


def an_end(number: int, clearance_mm: float, success: bool) -> EpisodeView:
    return EpisodeView(
        task=TASK,
        episode=number,
        shape="cuboid",
        initial_offset=(float(number), 0.0, 0.0),
        outcome="success" if success else "steps",
        success=success,
        env_steps=4,
        draws={"clearance_mm": clearance_mm},
    )


def test_each_drawn_quantity_has_a_plot_of_its_parts() -> None:
    ends = [an_end(1, 0.6, False), an_end(2, 0.7, True), an_end(3, 1.9, True)]
    [figure] = success_by_draw("track_1_peg_robust", TASK, ends)
    assert figure.title == "Clearance of the hole per side [mm]"
    assert figure.summary == "Success by Clearance of the hole per side [mm]: 50.0\xa0%, 100.0\xa0%"
    assert figure.table.rows[0][:3] == ("0.5 to 0.875", "1 of 2", "50.0\xa0%")
    assert figure.drawing.count('class="point"') == 2


def test_plots_follow_the_tables_order_of_the_task_and_stay_in_the_drawing() -> None:
    _, task = find_task(TASK)
    draws = {name: low for name, (low, _) in task.draws.items()}
    ends = [an_end(1, 0.5, True).model_copy(update={"draws": draws})]
    figures = success_by_draw("track_1_peg_robust", TASK, ends)
    assert {figure.key for figure in figures} == {f"draws-{TASK}-{name}" for name in task.draws}


@pytest.mark.parametrize(("track", "task"), [("track_1", "peg-insertion"), ("track_1", "gone")])
def test_a_task_that_draws_nothing_has_none(track: str, task: str) -> None:
    assert success_by_draw(track, task, [an_end(1, 0.6, True)]) == []
