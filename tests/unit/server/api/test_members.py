import pytest
from pydantic import TypeAdapter, ValidationError
from vitac.server.api.members import Email

ADDRESS: TypeAdapter[str] = TypeAdapter(Email)
NONE = r"""ann @x a@ x@[a a,b@c a;b@c a:b@c "ab"@c a(b)@c a\b@c a@b@c =?x?=@c a..b@c .a@c a@c. <a@c>"""


@pytest.mark.parametrize("address", ["ann@example.org", "o'brien+vitac@mail.example.org", "a@localhost", "1_2-3@x.y"])
def test_an_address_of_a_person_is_taken(address: str) -> None:
    assert ADDRESS.validate_python(address) == address


@pytest.mark.parametrize("address", [*NONE.split(), "", "a b@c", "a@b\n", "a@c\0", "\u00fc@c", "a" * 250 + "@c.de"])
def test_what_is_no_single_address_is_refused(address: str) -> None:
    with pytest.raises(ValidationError):
        ADDRESS.validate_python(address)
