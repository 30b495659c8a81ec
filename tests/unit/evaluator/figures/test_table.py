from vitac.evaluator.figures.table import list_missing_rows, make_rows, reference_figures


def test_every_figure_has_a_value_beside_that_of_the_reference_gel() -> None:
    reference = reference_figures()
    rows = list(make_rows(reference, reference))
    assert len(rows) == len({row.name for row in rows}) == 24
    assert all(row.value == row.reference is not None for row in rows)
    assert [row.unit for row in rows if row.name.startswith("standard score")] == ["%"] * 9


def test_figures_that_were_not_measured_have_no_row() -> None:
    quick = reference_figures().model_copy(update={"information": None, "robustness": (), "cpu_s": None})
    rows = list(make_rows(quick, reference_figures()))
    assert [row.name for row in rows][-1] == "smallest det F"
    assert len(rows) == 8
    fewer = list(make_rows(reference_figures(), quick))
    assert fewer[-1].reference is None


def test_every_figure_that_is_missing_has_a_reason() -> None:
    whole = reference_figures()
    assert list(list_missing_rows(whole)) == []
    deaf = whole.touch.model_copy(update={"normal_px_n": None, "shear_px_n": None, "pin_mm": None})
    assert list(list_missing_rows(whole.model_copy(update={"touch": deaf}))) == [
        "Sensitivity or resolution has no median: no place of the map senses."
    ]
    assert list(list_missing_rows(whole.model_copy(update={"information": None}))) == [
        "Information and bounds are not there: at no start did all IPC steps converge."
    ]
    quick = whole.model_copy(update={"starts": 0, "information": None, "robustness": (), "cpu_s": None})
    assert [sentence.endswith("no start was measured.") for sentence in list_missing_rows(quick)] == [True] * 3
