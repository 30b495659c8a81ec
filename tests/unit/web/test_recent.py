import asyncio

import pytest
from vitac.web import front as module
from vitac.web.front import Recent


def test_what_many_ask_for_is_read_again_after_a_while_and_not_kept_where_reading_failed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0
    reads: list[int] = []
    monkeypatch.setattr(module, "monotonic", lambda: now)
    recent: Recent[int] = Recent(kept_s=5.0)

    async def read() -> int:
        if now == 105.0 and len(reads) == 1:
            reads.append(0)
            raise OSError("gone")
        reads.append(len(reads))
        return len(reads)

    assert [asyncio.run(recent.get(read)) for _ in range(3)] == [1, 1, 1]
    now = 105.0
    with pytest.raises(OSError, match="gone"):
        asyncio.run(recent.get(read))
    assert asyncio.run(recent.get(read)) == 3
