import asyncio

from vitac.server.api.middleware.places import Places, SharedTime


def test_places_go_to_the_lowest_rank_as_it_is_by_then() -> None:
    async def take_all() -> list[str]:
        places, order = Places(1), list[str]()
        ranks = {"flood": 0.0, "gone": 1.0, "flood again": 0.0, "honest": 2.0, "honest too": 2.0}
        await places.take(lambda: 0.0)

        async def work(name: str) -> None:
            await places.take(lambda: ranks[name])
            order.append(name)
            places.leave()

        tasks = [asyncio.create_task(work(name)) for name in ranks]
        await asyncio.sleep(0)
        ranks["flood"] = ranks["flood again"] = 5.0
        tasks[1].cancel()
        places.leave()
        await asyncio.gather(*tasks, return_exceptions=True)
        return order

    assert asyncio.run(take_all()) == ["honest", "honest too", "flood", "flood again"]


def test_requests_at_work_share_the_time_that_passes() -> None:
    now = [0.0]
    shared = SharedTime(lambda: now[0])
    first = shared.begin()
    now[0] = 1.0
    second = shared.begin()
    now[0] = 3.0
    assert shared.end(second) == 1.0
    now[0] = 4.0
    assert shared.end(first) == 3.0
