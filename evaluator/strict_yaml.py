"""YAML as plain data, for our own documents and for untrusted ones. Called by `strict_model`."""

from typing import Any, Final

import yaml
from yaml.constructor import SafeConstructor
from yaml.nodes import MappingNode, Node, ScalarNode

try:
    from yaml import CSafeLoader as FastLoader
except ImportError:  # PyYAML was built without libyaml, which reads ten times as fast.
    from yaml import SafeLoader as FastLoader  # type: ignore[assignment]

UNTRUSTED_MAX_NODES: Final = 1_000
UNTRUSTED_MAX_DEPTH: Final = 8
_UNTRUSTED_TYPES: Final = frozenset(f"tag:yaml.org,2002:{name}" for name in ("bool", "float", "int", "null"))
"""What an untagged scalar may be besides text. Dates and merge keys are text."""
_KEY_SHOWN_CHARS: Final = 80


class _UniqueKeys(SafeConstructor):
    """Refuses a key given twice, where PyYAML would silently keep the last one."""

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Build one mapping after looking for repeated keys."""
        seen: set[object] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, ScalarNode):
                raise _refusal("a key must be text, expected no list or mapping", key_node)
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise _refusal(f"key {key_node.value[:_KEY_SHOWN_CHARS]!r} is given twice", key_node)
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_object(self, node: Node, deep: bool = False) -> Any:
        """Build one value; a scalar that PyYAML takes for a number and cannot read is a YAML error like any other."""
        try:
            return super().construct_object(node, deep)
        except (ValueError, OverflowError) as error:
            raise _refusal("a value looks like a number or date, but is none; put it in quotes", node) from error


class UniqueKeyLoader(_UniqueKeys, FastLoader):
    """Safe YAML loader for documents of our own, as fast as there is one: every command reads the tracks.

    It is for nothing untrusted: tens of thousands of nested lists end the process.
    """


class UntrustedLoader(_UniqueKeys, yaml.SafeLoader):
    """Loader for untrusted documents: no tags, anchors or aliases, and a small number of values.

    Tags choose constructors and aliases multiply what is built, so that a few hundred bytes could cost seconds.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012 - PyYAML's own way to choose them
        first: [(tag, pattern) for tag, pattern in resolvers if tag in _UNTRUSTED_TYPES]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._n_nodes = 0
        self._depth = 0

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """Compose one value from its events, unless it is of a kind or number that is refused."""
        self._check(self.peek_event())  # type: ignore[no-untyped-call]
        self._n_nodes += 1
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def _check(self, event: yaml.Event) -> None:
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _refusal("anchors (&) and aliases (*) are not allowed; write the value out", event)
        if getattr(event, "tag", None) is not None:
            raise _refusal("tags (!) are not allowed; write plain values", event)
        if self._n_nodes >= UNTRUSTED_MAX_NODES:
            raise _refusal(f"more than {UNTRUSTED_MAX_NODES} values", event)
        if self._depth >= UNTRUSTED_MAX_DEPTH:
            raise _refusal(f"values are nested more than {UNTRUSTED_MAX_DEPTH} deep", event)


def _refusal(problem: str, place: Any) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(None, None, problem, place.start_mark)
