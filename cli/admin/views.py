"""Prints answers for organizers where a table of fields does not do. Called by the table of verbs."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from ..client.status import show as show_status
from ..client.verbs import print_fields, print_rows, readable
from ..terminal.output import percent, print_pairs, print_records, print_table

Given = Mapping[str, Any]
WINNERS = ("track", "place", "team", "amount", "currency", "rank", "won_by", "total", "points")
EVALUATIONS = ("id", "team", "submission", "run", "state", "success", "steps", "verdict", "alarms", "copied", "created")
SUBMISSIONS = ("submission", "team", "name", "track", "state", "episodes", "success", "steps", "submitted")
WORKERS = ("id", "host", "pid", "state", "evaluator_version", "shards", "isolation", "heartbeat_at", "message")
REJUDGED = ("team", "submission", "state", "success", "new success", "steps", "new steps", "rank", "new rank", "note")
JUDGED = ("team", "submission", "success", "judges", "mark", "spread", "figures", "total", "conflicts")
LOST = "lost"


def print_definition(answer: Any, _: Given) -> None:
    """Print what a competition is, and its revision."""
    definition = answer["definition"]
    stages = [f"{name}/{stage['name']}" for name, track in definition["tracks"].items() for stage in track["stages"]]
    names = {"competition": definition["name"], "title": definition["title"], "stages": ", ".join(stages)}
    print_pairs(names | {"revision": answer["revision"]})


def print_proposal(answer: Any, _: Given) -> None:
    """Print who would advance, and what is not settled."""
    rows = [
        [
            team["rank"],
            team["team"],
            percent(team["success_rate"]),
            " to ".join(str(percent(end)) for end in team["interval"]),
            team["mean_steps"],
            "yes" if team["advances"] else "no",
            "at the border" if team["at_border"] else None,
        ]
        for team in answer["teams"]
    ]
    before = answer["before"]
    print(f"{answer['rule']}, by the board of {before}; {answer['registered']} teams are registered.")
    columns = ("rank", "team", "success", "95 % interval", "steps", "advances", "")
    print_table(columns, rows, none=f"No team is ranked in {before}.")
    if answer["unranked"]:
        names = ", ".join(answer["unranked"])
        print(f"Not ranked, made by another evaluator version: {names}. Requeue them first.")
    if answer["running"]:
        print(f"{answer['running']} evaluations of {before} wait or run.")


def print_confirmed(answer: Any, given: Given) -> None:
    """Print who takes part."""
    print(f"{given['stage']} of {given['track']}: {', '.join(answer['confirmed']) or 'no team'}")


def print_teams(answer: Any, _: Given) -> None:
    """Print who was confirmed, and by which revision others can be."""
    print("\n".join(answer["confirmed"]) or "Nobody was confirmed.")
    if answer["confirmed"]:
        print(f"To confirm other teams without a question: --yes --base {answer['revision']}", file=sys.stderr)


def print_winners(answer: Any, _: Given) -> None:
    """Print who wins what."""
    rows = [row | {"total": percent(row["total"])} for row in answer["items"]]
    print_records(rows, WINNERS, none="Nobody wins.", as_json=False)


def print_rubric(answer: Any, _: Given) -> None:
    """Print criteria and weights."""
    criteria = [[each["name"], each["title"]] for each in answer["criteria"]]
    print_table(("criterion", "marks from 0 to 10 for"), criteria, none="")
    weights = ", ".join(f"{name} {weight:g}" for name, weight in answer["weights"].items())
    print(f"weights: {weights}; at least {answer['judges_at_least']} judges")


def print_judged(answer: Any, _: Given) -> None:
    """Print what the judges think of each team."""
    rows = [
        [
            team["team"],
            team["submission"],
            percent(team["success_rate"]),
            len(team["judges"]),
            team["mark"],
            team["spread"],
            percent(team["figures"]),
            percent(team["total"]),
            ", ".join(f"{name} (marks set aside)" if name in team["set_aside"] else name for name in team["conflicts"]),
        ]
        for team in answer
    ]
    print_table(JUDGED, rows, none="The board is empty.")


def print_started(answer: Any, _: Given) -> None:
    """Print how many submissions are evaluated again."""
    count = f"{len(answer['submissions'])} submissions"
    is_begun = answer["id"] is not None
    print(f"rejudgement {answer['id']} of {count}; see `vitac admin rejudge show`" if is_begun else count)


def print_rejudged(answer: Any, _: Given) -> None:
    """Print which scores and ranks would change."""
    rejudged = answer["submissions"]
    print_table(REJUDGED, [_rejudged(row) for row in rejudged], none="It has no submissions.")
    print(f"{sum(row['changes'] for row in rejudged)} of {len(rejudged)} submissions would change score or rank")


def _rejudged(row: Any) -> list[object]:
    before, after = row["before"], row["after"]
    pairs = [(percent(before["success_rate"]), percent(after["success_rate"]))]
    pairs += [(before[name], after[name]) for name in ("mean_steps", "rank")]
    note = "keeps its result" if row["keeps_result"] else after["verdict"] or ("changes" if row["changes"] else None)
    return [row["team"], row["submission"], row["state"], *(cell for pair in pairs for cell in pair), note]


def print_added_team(answer: Any, _: Given) -> None:
    """Print a new team with its token."""
    team, secret = answer["team"], answer["token"]["secret"]
    print_pairs({"team": team["name"], "id": team["id"], "token": secret})
    if secret is not None:
        print("\nThe token is not shown again. Hand it to the team; it is used as VITAC_TOKEN.")


def print_team(answer: Any, _: Given) -> None:
    """Print a team with its members."""
    print_fields(
        {name: value for name, value in answer.items() if name != "members"}
        | {"invitations": len(answer["invitations"])}
    )
    print()
    print_rows(answer["members"], ("name", "role", "email", "joined_at", "left_at"), none="")


def print_data(answer: Any, _: Given) -> None:
    """Print how much there is of a team."""
    lists = {"members": answer["team"]["members"]} | {
        name: part for name, part in answer.items() if isinstance(part, list)
    }
    counts = {name.replace("_", " "): len(part) for name, part in lists.items()}
    print_pairs({"team": answer["team"]["name"]} | counts)
    print("\n--json prints all of it.")


def print_submissions(answer: Any, _: Given) -> None:
    """Print a page of submissions."""
    print_table(SUBMISSIONS, [_submission(item) for item in answer["items"]], none="No such submission.")
    if answer["next_before"] is not None:
        print(f"\nThere are older ones: --before {answer['next_before']}")


def _submission(item: Any) -> list[object]:
    evaluation = item["evaluation"]
    done = f"{evaluation['progress']['episodes_done']}/{evaluation['progress']['episodes_total']}"
    score = [percent(evaluation["success_rate"]), evaluation["mean_steps"], readable(item["submitted_at"])]
    return [item["id"], item["team"]["name"], item["name"], item["track"], evaluation["state"], done, *score]


def print_submission(answer: Any, _: Given) -> None:
    """Print a submission as its team sees it."""
    show_status(answer)


def print_copies(answer: Any, _: Given) -> None:
    """Print near copies, and similar archives."""
    columns = ["submission", "team", "like", "of team", "task", "list", "near", "difference", "code", "weights"]
    near = [
        [
            *_copied(one),
            one["task"],
            "sealed" if one["sealed"] else "public",
            f"{one['near']} of {one['episodes']}",
            f"{one['difference']:.5f}",
            percent(one["code"]),
            percent(one["weights"]),
        ]
        for one in answer["near"]
    ]
    print_table(columns, near, none="No submission is near another team's.")
    if answer["archives"]:
        print("\nSimilar archives:")
        rows = [
            [*_copied(one), one["track"], percent(one["code"]), percent(one["weights"])] for one in answer["archives"]
        ]
        print_table(["submission", "team", "like", "of team", "track", "code", "weights"], rows, none="")


def _copied(one: Any) -> list[object]:
    return [one[name] for name in ("submission_id", "team", "earlier_submission_id", "earlier_team")]


def print_evaluations(answer: Any, _: Given) -> None:
    """Print evaluations."""
    rows = [
        [
            row["id"],
            row["team"],
            row["submission_id"],
            row["run"],
            row["state"],
            percent(row["success_rate"]),
            row["mean_steps"],
            row["verdict"]["code"] if row["verdict"] else None,
            row["differing_episodes"] or None,
            row["copied_episodes"] or None,
            readable(row["created_at"]),
        ]
        for row in answer
    ]
    print_table(EVALUATIONS, rows, none="No such evaluation.")


def print_evaluation(answer: Any, _: Given) -> None:
    """Print an evaluation with its shards, and an alarm where episodes differ."""
    print_pairs(_evaluation(answer))
    print()
    columns = ("shard", "task", "episodes", "state", "attempts", "worker")
    print_table(columns, [_shard(shard) for shard in answer["shards"]], none="It has no shards.")
    repeats = [
        [shard["number"], readable(each["at"]), each["cause"], each["reason"]]
        for shard in answer["shards"]
        for each in shard["repeats"]
    ]
    if repeats:
        print()
        print_table(("shard", "queued again", "cause", "reason"), repeats, none="")
    if answer["differing_episodes"]:
        _print_alarms(answer["differing_episodes"])


def _evaluation(evaluation: Any) -> dict[str, object]:
    progress, verdict = evaluation["progress"], evaluation["verdict"]
    return {
        "evaluation": evaluation["id"],
        "submission": evaluation["submission_id"],
        "team": evaluation["team"],
        "track": evaluation["track"],
        "run": evaluation["run"],
        "state": evaluation["state"],
        "episodes": f"{progress['episodes_done']} of {progress['episodes_total']}, {progress['successes']} successes",
        "success": percent(evaluation["success_rate"]),
        "steps": evaluation["mean_steps"],
        "verdict": f"{verdict['code']}: {verdict['message']}" if verdict else None,
        "result hash": evaluation["result_hash"],
        "evaluator": evaluation["evaluator_version"],
        "platform class": evaluation["platform_class"],
        "isolation": "; ".join(evaluation["isolation"]),
        "packages": "; ".join(f"{len(seen['versions'])}, digest {seen['digest']}" for seen in evaluation["packages"]),
        "created": readable(evaluation["created_at"]),
        "started": readable(evaluation["started_at"]),
        "finished": readable(evaluation["finished_at"]),
    }


def _shard(shard: Any) -> list[object]:
    episodes = f"{shard['episodes'][0]}..{shard['episodes'][-1]}"
    return [shard["number"], shard["task"], episodes, shard["state"], shard["attempts"], shard["worker_id"]]


def _print_alarms(alarms: Any) -> None:
    print("\nALARM: episodes were played again with another result than the stored one, which counts.")
    print("The policy or a machine is not deterministic.\n")
    columns = ("task", "episode", "stored record", "other record", "worker", "seen")
    rows = [
        [
            alarm["task"],
            alarm["episode"],
            alarm["stored_digest"][:8],
            alarm["differing_digest"][:8],
            alarm["worker_id"],
            readable(alarm["seen_at"]),
        ]
        for alarm in alarms
    ]
    print_table(columns, rows, none="")


def print_workers(answer: Any, _: Given) -> None:
    """Print workers with the state that holds: what one that is lost has said last does not."""
    rows = [worker | ({"state": LOST} if worker["is_lost"] else {}) for worker in answer]
    print_rows(rows, WORKERS, none="No worker has run in the last week; `vitac worker` starts one.")


def print_worker(answer: Any, _: Given) -> None:
    """Print one worker likewise."""
    print_fields(answer | ({"state": LOST} if answer["is_lost"] else {}))


def print_audit(answer: Any, _: Given) -> None:
    """Print lines of the audit log, long ones cut."""
    rows = [
        [
            readable(line["at"]),
            line["actor"],
            line["action"],
            line["subject"],
            _short(line["before"]),
            _short(line["after"]),
        ]
        for line in answer
    ]
    print_table(("when", "who", "what", "of", "before", "after"), rows, none="No such change.")


def _short(values: dict[str, object] | None) -> str | None:
    text = json.dumps(values, ensure_ascii=False) if values else ""
    return text if len(text) <= 80 else f"{text[:79]}…"
