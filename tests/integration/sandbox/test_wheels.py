"""A policy in the sandbox imports what its wheels bring, and the report lists it."""

import json
from pathlib import Path

import pytest
from submissions import FILES, submission_folder, wheel_bytes
from vitac.cli.main import main
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.shards.order import ShardOrder
from vitac.evaluator.shards.process import ShardProcesses
from vitac.evaluator.submission.sources import staged
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import cut

POLICY = """
import feelings, numpy
assert feelings.version == "1.0", feelings.version
assert feelings.__file__ == "/submission/site-packages/feelings/__init__.py", feelings.__file__
assert numpy.__version__ == "99.0" and numpy.asarray, numpy.__version__
"""
OWN_NUMPY = """
import importlib.machinery, importlib.util, sys
places = [place for place in sys.path if place.startswith("/opt/vitac/packages")]
specification = importlib.machinery.PathFinder.find_spec("numpy", places)
numpy = importlib.util.module_from_spec(specification)
sys.modules["numpy"] = numpy
specification.loader.exec_module(numpy)
numpy.__version__ = "99.0"
"""


@pytest.mark.slow
@pytest.mark.usefixtures("shared_simulation")
def test_a_policy_imports_its_wheels_before_what_all_policies_see(tmp_path: Path) -> None:
    files: dict[str, str | bytes] = {
        **FILES,
        "policy.py": POLICY + FILES["policy.py"],
        "wheels/feelings-1.0-py3-none-any.whl": wheel_bytes(),
        "wheels/numpy-99.0-py3-none-any.whl": wheel_bytes("numpy", "99.0", {"numpy/__init__.py": OWN_NUMPY}),
    }
    report = tmp_path / "report.json"
    arguments = ["--task", "peg-insertion", "--episodes", "1", "--json", str(report)]
    with pytest.raises(SystemExit) as caught:
        main(["evaluate", str(submission_folder(tmp_path / "mine", files)), *arguments])
    assert caught.value.code in {None, 0}
    packages = json.loads(report.read_text())["packages"]
    assert (packages["feelings"], packages["numpy"]) == ("1.0", "99.0")
    assert "llvmlite" in packages


@pytest.mark.usefixtures("shared_simulation")
def test_a_shard_says_what_its_policy_could_import(tmp_path: Path) -> None:
    files: dict[str, str | bytes] = {**FILES, "wheels/feelings-1.0-py3-none-any.whl": wheel_bytes()}
    (shard,) = cut(load_track("track_1").tasks["peg-insertion"], [1])
    with staged(submission_folder(tmp_path / "mine", files)) as folder, ShardProcesses() as processes:
        order = ShardOrder(
            kind=SubmissionKind.MODEL, submission=folder, track="track_1", task="peg-insertion", shard=shard.index,
            episodes=(1,), limits=Limits(),
        )  # fmt: skip
        with processes.running_shard(order) as process:
            assert [record.failure for record in process.records()] == [None]
            assert (process.packages or {})["feelings"] == "1.0"
