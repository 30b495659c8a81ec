"""Validated records for file borders: unknown keys are refused and the nearest valid one is named.

Used for track files, episode records and logs; YAML enters by `read_yaml` where we or an operator wrote the file, and
by `parse_untrusted_yaml` where somebody untrusted did.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from vitac.errors import VitacError
from yaml.constructor import SafeConstructor
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

try:
    from yaml import CSafeLoader as FastLoader
except ImportError:  # PyYAML was built without libyaml, which reads ten times as fast.
    from yaml import SafeLoader as FastLoader  # type: ignore[assignment]

UNTRUSTED_MAX_NODES: Final = 1_000
UNTRUSTED_MAX_DEPTH: Final = 8
_UNTRUSTED_TYPES: Final = frozenset(f"tag:yaml.org,2002:{name}" for name in ("bool", "float", "int", "null"))
"""What an untagged scalar may be besides text. Dates and merge keys are text."""
_MERGE: Final = "tag:yaml.org,2002:merge"
_OWN_TYPES: Final = _UNTRUSTED_TYPES | {_MERGE}
"""The same of a document of our own: dates are text, so that messages show them as they were written."""
_KEY_SHOWN_CHARS: Final = 80
_OTHER_BASES: Final = re.compile(r"[-+]?(0[0-7_]+|[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?)")
"""What YAML 1.1 reads as a number of base 8 or 60, and YAML 1.2 does not: `010` is 8 or 10, `12:30` is 750 or text."""


@dataclass(frozen=True)
class Ambiguous:
    """A value that programs read in different ways; no field takes it."""

    text: str

    def __str__(self) -> str:
        """Return it as it was written."""
        return self.text


def _choose_types(types: frozenset[str]) -> dict[str, list[tuple[str, Any]]]:
    """Return PyYAML's own way to choose what an untagged scalar is, with these besides text."""
    return {
        first: [(tag, pattern) for tag, pattern in resolvers if tag in types]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


class _UniqueKeys(SafeConstructor):
    """Refuses a key given twice, where PyYAML would silently keep the last one."""

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Build one mapping after looking for repeated keys."""
        seen: set[object] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, ScalarNode):
                raise _refusal("a key must be text, expected no list or mapping", key_node)
            if key_node.tag == _MERGE:
                continue  # `<<: *name` takes the keys of another mapping, which the own ones replace
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise _refusal(f"key {key_node.value[:_KEY_SHOWN_CHARS]!r} is given twice", key_node)
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_object(self, node: Node, deep: bool = False) -> Any:
        """Build one value; a scalar that PyYAML takes for a number and cannot read is a YAML error like any other."""
        if (
            isinstance(node, ScalarNode)
            and node.tag.endswith((":int", ":float"))
            and _OTHER_BASES.fullmatch(node.value)
        ):
            return Ambiguous(node.value)
        try:
            return super().construct_object(node, deep)
        except (ValueError, OverflowError) as error:
            shown = repr(node.value[:_SHOWN_CHARS])
            raise _refusal(f"{shown} looks like a number, but is none; put it in quotes", node) from error


class UniqueKeyLoader(_UniqueKeys, FastLoader):
    """Safe YAML loader for documents of our own, as fast as there is one: every command reads the tracks.

    It is for nothing untrusted: tens of thousands of nested lists end the process.
    """

    yaml_implicit_resolvers = _choose_types(_OWN_TYPES)


class UntrustedLoader(_UniqueKeys, yaml.SafeLoader):
    """Loader for untrusted documents: no tags, anchors or aliases, and a small number of values.

    Tags choose constructors and aliases multiply what is built, so that a few hundred bytes could cost seconds.
    """

    yaml_implicit_resolvers = _choose_types(_UNTRUSTED_TYPES)

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


_TOLD_PROBLEMS = 5
"""Maximum number of problems reported of one document; the rest is counted."""
_SHOWN_CHARS = 80
_SHOWN_BITS = 256
"""A larger integer is not written out: Python refuses to beyond 4,300 digits."""

ModelT = TypeVar("ModelT", bound=BaseModel)


Word = Annotated[str, Field(pattern=r"^[\w.+:-]+$", max_length=100)]
"""A name, version or hash: nothing that could steer a terminal or a page."""


class DocumentRejected(VitacError):
    """A file does not have the form its model asks for. The message says where and why."""


class StrictModel(BaseModel):
    """Base of every record that is read from a file: frozen, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def parse_yaml(model: type[ModelT], text: str, origin: str) -> ModelT:
    """Read one YAML document of our own into a model.

    Args:
        model: what the document must be.
        text: the document.
        origin: name of the file, for the error message.

    Raises:
        DocumentRejected: not YAML, a key twice, an unknown or missing key, or a value of the wrong type.
    """
    return _parse(model, text, origin, UniqueKeyLoader)


def read_yaml(model: type[ModelT], path: Path) -> ModelT:
    """Read a file with one YAML document of our own into a model.

    Raises:
        DocumentRejected: the file cannot be read, or as `parse_yaml`.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DocumentRejected(f"{path} cannot be read: {error}.") from error
    return parse_yaml(model, text, path.name)


def parse_untrusted_yaml(model: type[ModelT], text: str, origin: str) -> ModelT:
    """Read one untrusted YAML document into a model; bound the length of the text before.

    Raises:
        DocumentRejected: as `parse_yaml`, and where it has tags, anchors, aliases, or too many or too deep values.
    """
    return _parse(model, text, origin, UntrustedLoader)


def _parse(model: type[ModelT], text: str, origin: str, loader: type[UniqueKeyLoader | UntrustedLoader]) -> ModelT:
    try:
        content = yaml.load(text, Loader=loader)  # noqa: S506 - both derive from SafeLoader
    except yaml.YAMLError as error:
        raise DocumentRejected(f"{origin} is not valid YAML: {_explain_syntax(error, text)}") from error
    if content is None:
        raise DocumentRejected(f"{origin} is empty, expected {_needed_keys(model)}. Write these, or name another file.")
    try:
        read = model.model_validate(content)
    except ValidationError as error:
        written = _find_written(yaml.compose(text, Loader=loader))
        raise DocumentRejected(f"{origin}: {explain(model, error, written)}") from error
    if (ambiguous := next(_list_ambiguous(content), None)) is not None:
        raise DocumentRejected(
            f"{origin}: programs read {ambiguous.text} in different ways; put it in quotes, or write a number of base "
            "10 without zeros before it."
        )
    return read


def _list_ambiguous(content: object) -> Iterator[Ambiguous]:
    if isinstance(content, Ambiguous):
        yield content
    values = content.values() if isinstance(content, Mapping) else content if isinstance(content, list) else ()
    for value in values:
        yield from _list_ambiguous(value)


def _find_written(root: Node | None) -> "Written":
    """Return what says how a scalar of a document was written."""

    def find(place: Sequence[int | str]) -> str | None:
        node = root
        for part in place:
            if isinstance(node, MappingNode):
                node = next((value for key, value in node.value if key.value == str(part)), None)
            elif isinstance(node, SequenceNode) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
            else:
                return None
        return str(node.value) if isinstance(node, ScalarNode) and not node.style else None

    return find


def validate(model: type[ModelT], content: object, origin: str) -> ModelT:
    """Check parsed content against a model.

    Raises:
        DocumentRejected: with one sentence for each thing that is wrong.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise DocumentRejected(f"{origin}: {explain(model, error)}") from error


Written = Callable[[Sequence[int | str]], str | None]
"""Says how the scalar at a place of a document was written, without quotes; None where nobody knows."""


def explain(model: type[BaseModel], error: ValidationError, written: Written = lambda _: None) -> str:
    """Return one sentence for each problem of a validation error, with the nearest valid key for an unknown one.

    What follows from a problem further inside is left out: a list whose member is wrong is no empty list.

    Args:
        model: what the document must be.
        error: of its validation.
        written: how a scalar was written.
    """
    errors = error.errors(include_url=False)
    inside = {each["loc"][:n] for each in errors for n in range(len(each["loc"]))}
    problems = [each for each in errors if each["loc"] not in inside]
    more = f" And {len(problems) - _TOLD_PROBLEMS} more." if len(problems) > _TOLD_PROBLEMS else ""
    sentences = (_sentence(model, dict(problem), written) for problem in problems[:_TOLD_PROBLEMS])
    return " ".join(sentences) + more


def _sentence(model: type[BaseModel], problem: dict[str, Any], written: Written) -> str:
    place = ".".join(str(part) for part in problem["loc"])[:_SHOWN_CHARS] or "the document"
    if problem["type"] == "extra_forbidden":
        return f"Unknown key {place!r}; {_nearest(str(problem['loc'][-1]), _list_keys(model, problem['loc'][:-1]))}"
    if problem["type"] == "missing":
        return f"Missing key {place!r}; add it."
    if problem["type"] == "model_type" and not problem["loc"]:
        return f"Expected {_needed_keys(model)}, got {_shown(problem['input'])}."
    value, text = problem["input"], written(problem["loc"])
    given = "" if isinstance(value, dict | list) else f" (got: {_shown(value, text)})"
    message = problem["msg"].removeprefix("Value error, ").rstrip(".")  # pydantic's name for a rule of ours
    if problem["type"] == "string_type" and text is not None:
        in_quotes = f'; put it in quotes, "{text[:_SHOWN_CHARS]}"' if text else " after the colon"
        message = f"expected text{in_quotes}"
    elif problem["type"] == "tuple_type":
        message = "expected a list, such as [first, second]"
    elif isinstance(value, Ambiguous) and problem["type"] in {"int_type", "float_type"}:
        message = f"{message}; write a number of base 10 without zeros before it"
    sentence = f"{place}: {message}{given}"
    return sentence if sentence.endswith("?") else f"{sentence}."


def _needed_keys(model: type[BaseModel]) -> str:
    needed = [name for name, field in model.model_fields.items() if field.is_required()]
    return f"a document with the keys {', '.join(needed)}" if needed else "a document with keys"


def _shown(value: object, text: str | None = None) -> str:
    """Return a scalar for a message, cut before it is formatted; `text` is how it was written."""
    if isinstance(value, Ambiguous):
        return value.text[:_SHOWN_CHARS]
    if text is not None and (value is None or isinstance(value, bool)):
        read = "nothing" if value is None else str(value).lower()
        return f"{text}, which YAML reads as {read}" if text and text != read else read
    if text is not None and isinstance(value, int | float):
        return text[:_SHOWN_CHARS]
    if isinstance(value, str | bytes):
        return repr(value[:_SHOWN_CHARS])
    if isinstance(value, int) and value.bit_length() > _SHOWN_BITS:
        return f"an integer of {value.bit_length()} bits"
    if value is None or isinstance(value, bool | int | float):
        return repr(value)
    return type(value).__name__


def _nearest(key: str, valid: list[str]) -> str:
    close = get_close_matches(key, valid, n=1)
    return f"did you mean {close[0]!r}?" if close else f"valid keys are {', '.join(valid)}."


def _list_keys(model: type[BaseModel], place: tuple[int | str, ...]) -> list[str]:
    """Return the valid keys of the (nested) model that a location inside a document points to."""
    if not place:
        return sorted(model.model_fields)
    field = model.model_fields.get(str(place[0]))
    if field is None:
        return []
    keys: list[str] = []
    for inner in _list_models(field.annotation):
        # A mapping or list of models has one more location part: its key or index.
        rest = place[2:] if inner is not field.annotation and len(place) > 1 else place[1:]
        keys.extend(_list_keys(inner, rest))
    return keys


def _list_models(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _list_models(argument)


def _explain_syntax(error: yaml.YAMLError, text: str) -> str:
    """Return what is wrong with a text that is no YAML, with the line where that was noticed."""
    mark = getattr(error, "problem_mark", None)
    if not isinstance(error, yaml.MarkedYAMLError) or mark is None:
        return f"{' '.join(str(error).split())}. Correct the file."
    lines = text.splitlines()
    mark = error.context_mark if mark.line >= len(lines) and error.context_mark else mark
    line = next(iter(lines[mark.line : mark.line + 1]), "").strip()[:_SHOWN_CHARS]
    problem = " ".join(f"{error.context or ''} {error.problem or ''}".split())
    remedy = "" if "quotes" in problem else " Text with a colon or another special character needs quotes around it."
    return f"{problem}, in line {mark.line + 1}: {line!r}. Correct the file.{remedy}"
