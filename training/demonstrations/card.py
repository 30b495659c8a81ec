"""The card of a data set: what it is, who acted, from which starts, with what it was made, and its licence."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vitac.envs.observable import Observable
from vitac.evaluator.scoring.score import rate

from ..streams import FIRST_STREAM, STREAMS_PER_SEED
from .demonstration import FILE, DemonstrationKind, read_demonstrations, read_source
from .frames import choose_observables
from .origin import Origin, StoredEpisode, read_origin

LICENCE = "Apache-2.0"

_CARD = """---
license: apache-2.0
task_categories: [robotics]
tags: [LeRobot, tactile, vitac-arena]
configs:
- config_name: default
  data_files: data/*/*.parquet
---
# Demonstrations of {title}
{description}

An expert that knows the truth plays in the deterministic simulation of ViTac Arena. It sees what no policy sees
(`privileged.*`), so its actions are more than a policy can know.

| kind | episodes | successes | in % with 95 % interval |
|---|---|---|---|
{kinds}
{left_out}
- **Starts**: episode n starts with `reset(options={{"rng_seed": ({stream}, n)}})`, in no official list.
- **Made with**: `{env_id}` as in the task `{task}` of `{track}`, evaluator {evaluator}, solver {solver}, mesh hash
  {mesh}, on {platform}.
- **Made by**: `vitac data collect {task} --successes {successes} --seed {seed} --out DIR`, then `vitac data export`.
- **Replay**: `vitac data check FOLDER --replay {episodes}` plays them again and compares every state hash.
- **Licence**: {licence}. No person's data and no recording of others is in it.

| observed | shape | unit | meaning |
|---|---|---|---|
{observed}
"""


def make_card(origin: Origin, observables: Sequence[Observable[Any]]) -> str:
    """Return the card, as Markdown with the header that Hugging Face reads."""
    source, episodes = origin.source, origin.episodes
    task, made = source.task, source.manifest
    kinds = [_kind_row(kind, [each for each in episodes if each.kind is kind]) for kind in DemonstrationKind]
    return _CARD.format(
        title=task.title[0].lower() + task.title[1:],
        description=task.description.strip(),
        kinds="\n".join(row for row in kinds if row),
        left_out="" if any(each.outcome != "success" for each in episodes) else "\nFailures are left out.\n",
        stream=source.stream,
        env_id=task.env_id,
        task=made.task,
        track=made.track,
        evaluator=made.evaluator_version,
        solver=made.solver_version,
        mesh=made.mesh_hash,
        platform=made.platform_class,
        successes=sum(each.outcome == "success" for each in episodes),
        seed=(source.stream - FIRST_STREAM) // STREAMS_PER_SEED,
        episodes=len(episodes),
        licence=LICENCE,
        observed="\n".join(
            f"| `{entry.name}`{' (privileged)' if entry.privileged else ''} | {entry.shape} | {entry.unit} | "
            f"{entry.meaning} |"
            for entry in observables
        ),
    )


def make_card_of(folder: Path) -> str:
    """Return the card of a folder with demonstrations, or that in a data set.

    Raises:
        CollectionRejected: its demonstrations are not what was written.
        NotOurs: it is neither.
    """
    if not (folder / FILE).exists():
        read_origin(folder)
        return (folder / "README.md").read_text()
    source = read_source(folder / FILE)
    stored = tuple(StoredEpisode.of(each) for each in read_demonstrations(folder / FILE))
    return make_card(Origin(source=source, episodes=stored), choose_observables(source.task, None))


def _kind_row(kind: DemonstrationKind, episodes: Sequence[StoredEpisode]) -> str | None:
    if not episodes:
        return None
    found = rate(sum(each.outcome == "success" for each in episodes), len(episodes))
    percent = [f"{100 * part:.1f}" for part in (found.success_rate, found.interval.low, found.interval.high)]
    return f"| {kind.value} | {found.episodes} | {found.successes} | {percent[0]} [{percent[1]}, {percent[2]}] |"
