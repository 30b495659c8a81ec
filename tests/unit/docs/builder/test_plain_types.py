"""docs/builder/plain_types.py: types of checked fields for readers."""

import pytest
from docutils import nodes
from plain_types import _rewrite, plain_type
from sphinx import addnodes

WORD = "Annotated[str, FieldInfo(annotation=NoneType, metadata=[_PydanticGeneralMetadata(pattern='^[0-9a-f]{64}$')])]"
COUNT = "Annotated[int, FieldInfo(annotation=NoneType, required=True, metadata=[Ge(ge=1), Le(le=100)])]"


@pytest.mark.parametrize(
    ("written", "read"),
    [
        (COUNT, "int of 1 to 100"),
        ("Annotated[float, Ge(ge=0)]", "float at least 0"),
        ("Annotated[int, Gt(gt=0)] | None", "int above 0 | None"),
        (WORD, "str"),
        (f"tuple[{COUNT}, {WORD}, ...]", "tuple[int of 1 to 100, str, ...]"),
        ("dict[str, Annotated[int, Ge(ge=0)]]", "dict[str, int at least 0]"),
        ("Mapping[str, float]", "Mapping[str, float]"),
        ("Annotated[int, cut off", "int"),
        ("Annotated[dict[str, int], Len(min_length=1)]", "dict[str, int]"),
        ("Annotated[tuple[Annotated[int, Le(le=9)], ...], Len(min_length=1)]", "tuple[int at most 9, ...]"),
        ("Annotated[float, Gt(gt=0), Le(le=1)]", "float above 0 and at most 1"),
        ("Annotated[float, Ge(ge=-1.5), Lt(lt=1e-3)]", "float at least -1.5 and below 1e-3"),
    ],
)
def test_an_annotated_type_is_its_type_and_bounds(written: str, read: str) -> None:
    assert plain_type(written) == read


def described(*, field_name: str, field_type: str, annotation: str) -> tuple[addnodes.desc, addnodes.desc_content]:
    signature = addnodes.desc_signature("", "", addnodes.desc_annotation("", annotation))
    field = nodes.field("", nodes.field_name("", field_name), nodes.field_body("", nodes.paragraph("", field_type)))
    content = addnodes.desc_content("", nodes.field_list("", field))
    return addnodes.desc("", signature, content), content


@pytest.mark.parametrize("field_name", ["type rounds", "rtype"])
def test_fields_and_signatures_are_rewritten(field_name: str) -> None:
    whole, content = described(field_name=field_name, field_type=COUNT, annotation=f": {COUNT}")
    _rewrite(None, "py", "attribute", content)  # type: ignore[arg-type]  # needs no application
    assert [node.astext() for node in whole.findall(nodes.field_body)] == ["int of 1 to 100"]
    assert [node.astext() for node in whole.findall(addnodes.desc_annotation)] == [": int of 1 to 100"]


@pytest.mark.parametrize(("domain", "field_name"), [("py", "param rounds"), ("std", "type rounds")])
def test_what_is_no_type_of_python_stays(domain: str, field_name: str) -> None:
    whole, content = described(field_name=field_name, field_type=COUNT, annotation=": int")
    _rewrite(None, domain, "attribute", content)  # type: ignore[arg-type]  # needs no application
    assert [node.astext() for node in whole.findall(nodes.field_body)] == [COUNT]
    assert [node.astext() for node in whole.findall(addnodes.desc_annotation)] == [": int"]
