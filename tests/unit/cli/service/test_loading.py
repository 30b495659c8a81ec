import gc
from collections.abc import Iterator

import pytest
from vitac.cli.service.web_server import no_collections


@pytest.fixture(autouse=True)
def _collections_as_before() -> Iterator[None]:
    was_enabled = gc.isenabled()
    yield
    (gc.enable if was_enabled else gc.disable)()


@pytest.mark.parametrize("as_before", [True, False])
def test_garbage_is_collected_afterwards_as_it_was_before(as_before: bool) -> None:
    (gc.enable if as_before else gc.disable)()
    with no_collections():
        assert not gc.isenabled()
    assert gc.isenabled() is as_before


def test_garbage_is_collected_again_after_a_module_that_is_missing() -> None:
    gc.enable()
    with pytest.raises(ModuleNotFoundError), no_collections():
        raise ModuleNotFoundError
    assert gc.isenabled()


def test_what_was_loaded_is_left_alone() -> None:
    before = gc.get_freeze_count()
    with no_collections():
        loaded = [[number] for number in range(10_000)]
    assert gc.get_freeze_count() >= before + len(loaded)
