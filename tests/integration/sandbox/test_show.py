"""`vitac show --policy` plays a policy in its sandbox, and puts what it believes beside what is true."""

import json
from pathlib import Path

import pytest
from submissions import MANIFEST, submission_folder
from vitac.cli.main import main

POLICY = """
class Policy:
    def reset(self, task):
        self.looks = 0

    def act(self, observation):
        self.looks += 1
        return [0.5, 0.0, 0.0]

    def belief(self):
        return None if self.looks == 1 else [{answer}]
"""


def shown(
    folder: Path, capsys: pytest.CaptureFixture[str], *options: str, answer: str = "0.0, -1.0, self.looks"
) -> tuple[int, str, str]:
    submission = submission_folder(
        folder / "Track_1", {"policy.py": POLICY.replace("{answer}", answer), "submission.yaml": MANIFEST}
    )
    arguments = ["--policy", str(submission), "--out", str(folder / "end.png"), "--width", "600", *options]
    with pytest.raises(SystemExit) as caught:
        main(["show", "peg-insertion", "--episode", "1", *arguments])
    out, err = capsys.readouterr()
    return int(caught.value.code or 0), out, err


def test_what_a_policy_believes_is_told_beside_what_is_true(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = shown(tmp_path, capsys, "--json")
    assert code == 0
    told = json.loads(out)
    rows = told["beliefs"]
    assert [row["env_step"] for row in rows] == list(range(1, told["env_steps"]))
    assert [row["believed"] for row in rows] == [pytest.approx([0.0, -1.0, 1.0 + row["env_step"]]) for row in rows]
    assert len({tuple(row["true"]) for row in rows}) == len(rows) > 0
    assert (tmp_path / "end.png").exists()


@pytest.mark.parametrize(
    ("answer", "named"),
    [
        ("float('nan'), 0.0, 0.0", "Belief is [nan, 0.0, 0.0], expected finite numbers in the range of float32."),
        ("0.0, 0.0", "Belief has shape (2,), expected (3,)."),
        ("self.reset()", "belief() raised TypeError: "),
    ],
)
def test_a_wrong_belief_is_told_once_and_the_episode_is_drawn_without(
    answer: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = shown(tmp_path, capsys, "--json", answer=answer)
    told = json.loads(out)
    assert (code, told["beliefs"]) == (0, [])
    assert told["env_steps"] > 2, "it was asked again, had it been asked once more"
    assert err.count("WARNING: ") == 1
    assert f"WARNING: What the policy believes is not drawn from here on: {named}" in err
    assert (tmp_path / "end.png").exists()


def test_a_belief_beyond_a_limit_ends_the_episode_with_its_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = shown(tmp_path, capsys, answer="print('x' * 100_000_000)")
    assert (code, out) == (1, "")
    assert "bytes were printed." in err
    assert "WARNING" not in err
    assert not (tmp_path / "end.png").exists()
