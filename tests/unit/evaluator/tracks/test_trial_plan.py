from collections import Counter

from vitac.evaluator.tracks.trial_plan import draw_plan

SECRET, OTHER = bytes(32), bytes([1]) * 32
ENTRIES = [f"entry {number}" for number in range(9)]
STARTS = [f"start {number}" for number in range(30)]
STATIONS = ("east", "west")


def blocks(secret: bytes = SECRET, control: str | None = None) -> list[list[tuple[str, str, str]]]:
    plan = draw_plan(secret, entries=ENTRIES, starts=STARTS, stations=STATIONS, control=control)
    each = [(trial.entry, trial.start, trial.station) for trial in plan]
    return [each[first : first + len(ENTRIES)] for first in range(0, len(each), len(ENTRIES))]


def test_in_each_block_everybody_plays_the_same_start_once() -> None:
    for block in blocks():
        assert {entry for entry, _, _ in block} == set(ENTRIES)
        assert len({start for _, start, _ in block}) == 1
    assert {block[0][1] for block in blocks()} == set(STARTS)


def test_orders_differ_between_blocks_and_follow_from_the_secret_alone() -> None:
    orders = [tuple(entry for entry, _, _ in block) for block in blocks()]
    assert len(set(orders)) == len(STARTS)
    shuffled = draw_plan(SECRET, entries=ENTRIES[::-1], starts=STARTS[::-1], stations=STATIONS)
    assert [trial.entry for trial in shuffled] == [entry for order in orders for entry in order]
    assert blocks(OTHER) != blocks()


def test_stations_share_every_block_and_everybody_plays_at_each() -> None:
    at: Counter[tuple[str, str]] = Counter()
    for block in blocks():
        shares = Counter(station for _, _, station in block)
        assert abs(shares["east"] - shares["west"]) == 1
        at.update((entry, station) for entry, _, station in block)
    assert min(at[entry, station] for entry in ENTRIES for station in STATIONS) >= 8


def test_the_control_opens_every_block_one_station_after_the_other() -> None:
    opening = [block[0] for block in blocks(control="entry 4")]
    assert {entry for entry, _, _ in opening} == {"entry 4"}
    assert [station for _, _, station in opening] == ["east", "west"] * 15
