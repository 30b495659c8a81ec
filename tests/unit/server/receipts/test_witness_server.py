"""What a witness answers to logs that ask it, by the requests with which other witnesses are tested."""

from pathlib import Path

import httpx
import pytest
from made_logs import LOG_KEY
from made_receipts import KEY
from vitac.server.receipts.witness import Witness
from vitac.server.receipts.witness_server import MAX_BODY_BYTES, CheckpointRequest, make_app
from vitac.server.transparency.merkle import make_tree
from vitac.server.transparency.notes import OF_LOG, Checkpoint, VerifierKey, sign_checkpoint

NAME = "ants.example/v"
PUBLISHED = """\
old 20852014
PlRNCrwHpqhGrupue0L7gxbjbMiKA9temvuZZDDpkaw=
jrJZDmY8Y7SyJE0MWLpLozkIVMSMZcD5kvuKxPC3swk=
5+pKlUdi2LeF/BcMHBn+Ku6yhPGNCswZZD1X/6QgPd8=
/6WVhPs2CwSsb5rYBH5cjHV/wSmA79abXAwhXw3Kj/0=

example.com/behind-the-sofa
20852163
CsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=

\N{EM DASH} example.com/behind-the-sofa Az3grlgtzPICa5OS8npVmf1Myq/5IZniMp+ZJurmRDeOoRDe4URYN7u5/Zhcyv2q1gGzGku9nTo+zyWE+xeMcTOAYQ8=
\N{EM DASH} example.com/behind-the-sofa opLqBQsREYCgu6xQkYQwJr9fo45a62DN9EdmHXnZdXNqlcVGlCum2Wks+49/V6267UEjw6QUXTS5Rovnzv++qbSzm9Q=
"""  # noqa: E501
"""The request that c2sp.org/tlog-witness shows."""

ORIGIN = "sigsum.org/v1/tree/4d6d8825a6bb689d459628312889dfbb0bcd41b5211d9e1ce768b0ff0309e562"
SIGSUM = VerifierKey(
    name=ORIGIN,
    kind=OF_LOG,
    public_key=bytes.fromhex("ffdc2d4d98e4124d3feaf788c0c2f9abfd796083d1f0495437f302ec79cf100f"),
)
"""The log of the tests of litewitness (github.com/FiloSottile/torchwood), whose requests and answers follow."""


def note(size: int, root: str, signature: str, origin: str = ORIGIN) -> str:
    return f"{origin}\n{size}\n{root}\n\n\N{EM DASH} {ORIGIN} UgIom{signature}\n"


ROOT_3, ROOT_5 = "RcCI1Nk56ZcSmIEfIn0SleqtV7uvrlXNccFx595Iwl0=", "QrtXrQZCCvpIgsSmOsah7HdICzMLLyDfxToMql9WTjY="
SIGNED_3 = "2VbtIcdFbwFAy1n7s6IkAxIY6J/GQOTuZF2ORV39d75cbAj2aQYwyJre36kezNobZs4SUUdrcawfAB8WVrx6go="
SIZE_1 = note(
    1,
    "KgAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA=",
    "7fPZTqpxWWhyjWduBvTvGVqsokMbqTArsQilegKoFBJQjUFAmQ0+YeSPM3wfUQMFSzVnnNuWRTYrajXpNUbIQY=",
)
SIZE_3 = note(3, ROOT_3, SIGNED_3)
SIZE_5 = note(
    5,
    ROOT_5,
    "w/EOJmWi0i1FQsOj+etB7F8IccFam/jgd6wzRns4QPVmyEZtdvl1U2KEmLOZ/ASRcWJi0tW90dJWAShei7sDww=",
)
LEAF_2, LEAF_3, LEAF_4, LEAF_5 = (f"Kg{n}AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA=" for n in ("E", "I", "M", "Q"))
HASH_3_4, HASH_1_2 = "+fUDV+k970B4I3uKrqJM4aP1lloPZP8mvr2Z4wRw2LI=", "wgiIFdZfYNv6WU1OllBKsWnLYIS/DBMqt8Uh/S4OukE="
REQUESTS = (
    (f"old 0\n\n{SIZE_1}", 200),
    (f"old 1\n{LEAF_2}\n{LEAF_3}\n\n{SIZE_3.replace('x6go=', 'x6gx=')}", 403),
    (f"old 1\n{LEAF_2}\n{LEAF_3}\n\n{note(3, ROOT_3, SIGNED_3, ORIGIN[:-1] + '3')}", 404),
    (f"old 1\n\n{SIZE_3}", 422),
    (f"old 1\n{LEAF_2}\n{LEAF_3.replace('AAA=', 'ABA=')}\n\n{SIZE_3}", 422),
    (f"old 1\n{LEAF_2}\n{LEAF_3}\n\n{SIZE_3}", 200),
    (f"old 1\n{LEAF_2}\n{HASH_3_4}\n{LEAF_5}\n\n{SIZE_5}", 409),
    (f"old 3\n{LEAF_3}\n{LEAF_4}\n{HASH_1_2}\n{LEAF_5}\n\n{SIZE_5}", 200),
    (f"old 0\n\n{SIZE_5}", 409),
    (f"old 5\n\n{SIZE_5.partition(chr(10) * 2)[0]}\n", 400),
    (f"old 5\n\n{SIZE_5.replace(f'{chr(10)}5{chr(10)}', f'{chr(10)}five{chr(10)}')}", 400),
    (f"old 6\n\n{SIZE_5}", 400),
    (f"old 5\n\n{SIZE_5}", 200),
    ("old 5\n" + 64 * f"{LEAF_2}\n" + f"\n{SIZE_5}", 400),
    (f"old 05\n\n{SIZE_5}", 400),
    ("x" * (MAX_BODY_BYTES + 1), 400),
)


def asking(folder: Path, *logs: VerifierKey) -> httpx.AsyncClient:
    app = make_app(Witness(folder, NAME), logs)
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://witness")


def test_the_published_request_is_read() -> None:
    asked = CheckpointRequest.parse(PUBLISHED.encode())
    assert (asked.old_size, len(asked.proof), str(asked.checkpoint)) == (20852014, 4, PUBLISHED.partition("\n\n")[2])


@pytest.mark.anyio
async def test_each_request_gets_the_answer_that_another_witness_gives(tmp_path: Path) -> None:
    async with asking(tmp_path, SIGSUM, LOG_KEY) as log:
        for body, expected in REQUESTS:
            answer = await log.post("/add-checkpoint", content=body.encode())
            assert answer.status_code == expected, (body, answer.text)
            if expected == 200:
                signed = Checkpoint.parse(body.partition("\n\n")[2] + answer.text)
                assert [by for by, _ in signed.find_witnesses([Witness(tmp_path).key])] == [Witness(tmp_path).key]
            if expected == 409:
                assert answer.headers["content-type"] == "text/x.tlog.size"
                assert answer.text == {1: "3\n", 0: "5\n"}[int(body[4])]
        assert (await log.get("/add-checkpoint")).status_code == 405


@pytest.mark.anyio
async def test_another_history_is_refused_and_its_proof_is_stored(tmp_path: Path) -> None:
    trees = [make_tree([bytes([kind, n] * 16) for n in range(6)]) for kind in (1, 2)]
    first, other = (sign_checkpoint(KEY, size=6, root=tree.root()) for tree in trees)
    shorter = sign_checkpoint(KEY, size=4, root=trees[0].root(4))
    async with asking(tmp_path, LOG_KEY) as log:
        empty = sign_checkpoint(KEY, size=0, root=bytes(32))
        assert (await log.post("/add-checkpoint", content=f"old 0\n\n{empty}".encode())).status_code == 422
        for old, checkpoint, expected in ((0, first, 200), (6, other, 409), (4, shorter, 409), (0, shorter, 409)):
            answer = await log.post("/add-checkpoint", content=f"old {old}\n\n{checkpoint}".encode())
            assert answer.status_code == expected
    (evidence,) = tmp_path.glob("*.rewritten")
    assert Checkpoint.parse(evidence.read_text()) == other
