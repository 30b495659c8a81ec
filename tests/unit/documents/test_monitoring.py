"""The alerts and the dashboard ask for metrics that a server shows, in expressions that Prometheus can read."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import promql_parser
import pytest
import yaml
from databases import opened_database
from prometheus_client.parser import text_string_to_metric_families
from service_factories import make_settings
from vitac.server.database.metrics import TotalsWriter
from vitac.server.operations.exposition import Exposition
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore

FOLDER = "docs/monitoring"
OF_PROMETHEUS = {"up"}


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """The samples of a server that something was counted in, with the names of their labels."""
    with opened_database() as database:
        settings = make_settings(state_dir=tmp_path_factory.mktemp("state"))
        services = Services(
            settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None
        )
        services.instruments.episodes.labels("peg-insertion").inc()
        services.instruments.requests_s.labels("GET", "/health", "2xx").observe(0.01)
        TotalsWriter(services.instruments).write(database)
        text = Exposition(services).text().decode()
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(text):
        found.setdefault(family.name, set())
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


@pytest.fixture(scope="module")
def alerts(repository: Path) -> list[dict[str, Any]]:
    (group,) = yaml.safe_load((repository / FOLDER / "alerts.yaml").read_text())["groups"]
    rules: list[dict[str, Any]] = group["rules"]
    return rules


@pytest.fixture(scope="module")
def panels(repository: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((repository / FOLDER / "dashboard.json").read_text())["panels"]
    return found


@pytest.fixture(scope="module")
def expressions(alerts: list[dict[str, Any]], panels: list[dict[str, Any]]) -> list[str]:
    return [rule["expr"] for rule in alerts] + [target["expr"] for panel in panels for target in panel["targets"]]


def selectors(node: Any) -> Iterator[Any]:
    """The vector selectors below a node of a parsed expression."""
    if isinstance(node, promql_parser.VectorSelector):
        yield node
    for name in ("expr", "lhs", "rhs", "vector_selector"):
        if (below := getattr(node, name, None)) is not None:
            yield from selectors(below)
    for argument in getattr(node, "args", None) or ():
        yield from selectors(argument)


def test_expressions_ask_for_metrics_and_labels_that_a_server_shows(
    expressions: list[str], shown: dict[str, set[str]]
) -> None:
    assert len(expressions) > 30
    for expression in expressions:
        found = list(selectors(promql_parser.parse(expression)))
        assert found, expression
        for selector in found:
            if selector.name not in OF_PROMETHEUS:
                assert selector.name in shown, expression
                asked = {matcher.name for matcher in selector.matchers.matchers} - {"job", "instance"}
                assert asked <= shown[selector.name], expression


def test_alerts_are_named_once_and_say_what_is_wrong(alerts: list[dict[str, Any]]) -> None:
    names = [rule["alert"] for rule in alerts]
    assert len(names) == len(set(names)) > 8
    for rule in alerts:
        assert set(rule) <= {"alert", "expr", "for", "labels", "annotations"}
        assert rule["labels"]["severity"] in {"page", "ticket"}
        assert rule["annotations"]["summary"].endswith(".")
        assert re.fullmatch(r"\d+[smh]", rule.get("for", "1m"))


def test_panels_have_titles_and_do_not_overlap(panels: list[dict[str, Any]]) -> None:
    assert len({panel["id"] for panel in panels}) == len({panel["title"] for panel in panels}) == len(panels)
    cells = [
        (x, y)
        for place in (panel["gridPos"] for panel in panels)
        for x in range(place["x"], place["x"] + place["w"])
        for y in range(place["y"], place["y"] + place["h"])
    ]
    assert len(cells) == len(set(cells))
    assert max(x for x, _ in cells) < 24


def test_manual_explains_every_metric_and_no_other(repository: Path, shown: dict[str, set[str]]) -> None:
    explained = set(re.findall(r"`(vitac_[a-z_]+)`", (repository / "docs" / "monitoring.md").read_text()))
    suffixes = ("_bucket", "_count", "_sum", "_total")
    families = {name for name in shown if name.startswith("vitac_") and not name.endswith(suffixes)}
    counters = {name for name in shown if name.endswith("_total") and name.startswith("vitac_")}
    assert explained == (families - {name.removesuffix("_total") for name in counters}) | counters


def test_dashboard_shows_every_metric(expressions: list[str], shown: dict[str, set[str]]) -> None:
    asked = {selector.name for expression in expressions for selector in selectors(promql_parser.parse(expression))}
    asked = {re.sub("_(bucket|count|sum)$", "", name) for name in asked}
    ours = {re.sub("_(bucket|count|sum|total)$", "", name) for name in shown if name.startswith("vitac_")}
    assert ours - {name.removesuffix("_total") for name in asked} == {"vitac_uploads"}
