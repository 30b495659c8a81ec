import threading

import pytest
from vitac.worker.slot import Slot


def is_free(places: threading.Semaphore) -> bool:
    free = places.acquire(blocking=False)
    if free:
        places.release()
    return free


def test_a_slot_is_free_again_when_its_work_is_over_however_it_ends() -> None:
    places, seen = threading.Semaphore(1), []
    Slot(places).hold(lambda: seen.append(is_free(places)))
    assert (seen, is_free(places)) == ([False], True)

    def fail() -> None:
        raise RuntimeError("it broke")

    with pytest.raises(RuntimeError):
        Slot(places).hold(fail)
    assert is_free(places)


def test_work_that_leaves_its_slot_frees_one_place_once() -> None:
    places, said = threading.Semaphore(2), []
    slot = Slot(places, soon=lambda: said.append("soon"))

    def work() -> None:
        slot.soon_left()
        slot.leave()
        slot.leave()
        assert [places.acquire(blocking=False) for _ in range(3)] == [True, True, False]
        places.release(2)

    slot.hold(work)
    assert [places.acquire(blocking=False) for _ in range(3)] == [True, True, False]
    assert said == ["soon"]


def test_work_waits_for_a_slot() -> None:
    places, begun, leaving = threading.Semaphore(1), threading.Event(), threading.Event()
    first, second = Slot(places), Slot(places)
    order = []

    def hold_first() -> None:
        begun.set()
        assert leaving.wait(60.0)
        order.append("first")
        first.leave()

    threads = [threading.Thread(target=first.hold, args=[hold_first])]
    threads[0].start()
    assert begun.wait(60.0)
    threads.append(threading.Thread(target=second.hold, args=[lambda: order.append("second")]))
    threads[1].start()
    leaving.set()
    for thread in threads:
        thread.join(60.0)
    assert order == ["first", "second"]
