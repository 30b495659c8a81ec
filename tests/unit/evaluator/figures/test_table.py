from vitac.evaluator.figures.reference import reference_figures
from vitac.evaluator.figures.table import rows_of


def test_every_figure_has_a_value_beside_that_of_the_reference_gel() -> None:
    reference = reference_figures()
    rows = list(rows_of(reference, reference))
    assert len(rows) == len({row.name for row in rows}) == 24
    assert all(row.value == row.reference is not None for row in rows)
    assert [row.unit for row in rows if row.name.startswith("standard score")] == ["%"] * 9


def test_figures_that_were_not_measured_have_no_row() -> None:
    quick = reference_figures().model_copy(update={"information": None, "robustness": (), "cpu_s": None})
    rows = list(rows_of(quick, reference_figures()))
    assert [row.name for row in rows][-1] == "smallest det F"
    assert len(rows) == 8
    fewer = list(rows_of(reference_figures(), quick))
    assert fewer[-1].reference is None
