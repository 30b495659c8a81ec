from vitac.web.documentation.reference import environments, modules


def test_a_module_is_described_with_its_public_names_only() -> None:
    text = modules(["vitac.evaluator.scoring.score"])
    assert (
        "#### wilson_interval\n```python\nwilson_interval(successes: float, episodes: float) -> Interval\n```" in text
    )
    assert "\n#### _" not in text


def test_only_the_names_asked_for_are_described() -> None:
    text = modules(["vitac.envs.vision.observables: RGB_IMAGES"])
    assert "#### RGB_IMAGES" in text
    assert text.count("####") == 1


def test_arguments_and_fields_are_lists_with_their_meaning() -> None:
    text = modules(["vitac.envs.tasks.insertion.env: InsertionSettings", "vitac.envs.tasks.peg_insertion.env"])
    assert "class InsertionSettings:\n    max_steps: int\n" in text
    assert "class PegInsertionSettings(InsertionSettings):\n    max_steps: int = 8\n" in text
    assert "\nAttributes:\n\n- `max_steps`: env steps after which an episode is cut off.\n- " in text


def test_environments_have_tables() -> None:
    text = environments()
    assert "## ViTac/PegInsertion-v1\nInsert a peg into the hole of a plate" in text
    assert "| marker_flow | (2, 2, 128, 2) |" in text
