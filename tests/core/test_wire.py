"""What goes over the wire is read again as it was written, whatever somebody puts into it."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from reverie_eval.schemas.service import Method, MethodChange
from reverie_eval.schemas.wire import LONGEST_LINK, LONGEST_NAME

HOST = "https://example.org/"
PADDED = "https://" + ".".join(["a" * 60] * 8) + ".org"


def is_kept(**said: object) -> bool:
    """Tell whether something may be said of a method; what may be is read again as it was kept."""
    try:
        method = Method.model_validate({"name": "Walker", **said})
    except ValidationError:
        return False
    kept = method.model_dump(mode="json")
    assert Method.model_validate(kept).model_dump(mode="json") == kept
    return True


@given(st.text(max_size=LONGEST_NAME + 2))
@example("\U0001d160" * 40)  # three letters in its composed form
@example("\ufb2c" * LONGEST_NAME)
def test_every_name_is_read_as_it_was_kept(name: str) -> None:
    is_kept(name=name)


@given(st.text(max_size=200))
@example("\U0001d160" * 1000)
@example("one\r\ntwo\x85three\u2028four")
def test_every_description_is_read_as_it_was_kept(description: str) -> None:
    is_kept(description=description)


@given(st.text(max_size=LONGEST_LINK))
@example(" " * 400)
@example("ü" * 300)
@example("?" + "\\" * 300)
@example("../" * 100)
def test_every_link_is_read_as_it_was_kept(rest: str) -> None:
    is_kept(paper=HOST + rest)
    is_kept(code="https://" + rest)


@pytest.mark.parametrize(
    ("link", "expected"),
    [
        pytest.param(f"{HOST}{'x' * (LONGEST_LINK - len(HOST))}", True, id="as long as it may be"),
        pytest.param(f"{HOST}{'x' * (LONGEST_LINK + 1 - len(HOST))}", False, id="a letter more"),
        pytest.param(f"{HOST}{'ü' * 100}", False, id="longer in the form in which it is kept"),
        pytest.param(PADDED + "?" + "q" * (LONGEST_LINK - len(PADDED) - 1), False, id="a slash"),
    ],
)
def test_how_long_a_link_may_be(link: str, *, expected: bool) -> None:
    assert is_kept(paper=link) is expected


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        pytest.param("x" * LONGEST_NAME, True, id="as long as it may be"),
        pytest.param(f"  {'x' * LONGEST_NAME}  ", True, id="with blanks around it"),
        pytest.param("e\u0301" * LONGEST_NAME, True, id="composed"),
        pytest.param("x" * (LONGEST_NAME + 1), False, id="a letter more"),
        pytest.param("\U0001d160" * 34, False, id="longer in the form in which it is kept"),
        pytest.param("  ", False, id="blank"),
    ],
)
def test_how_long_a_name_may_be(name: str, *, expected: bool) -> None:
    assert is_kept(name=name) is expected


@pytest.mark.parametrize(
    "letter",
    [
        pytest.param("\u3164", id="Hangul filler"),
        pytest.param("\u1160", id="Hangul vowel's filler"),
        pytest.param("\uffa0", id="narrow Hangul filler"),
        pytest.param("\u034f", id="joiner of graphemes"),
        pytest.param("\u17b5", id="Khmer vowel that is not shown"),
        pytest.param("\u180b", id="Mongolian variation"),
        pytest.param("\ufe00", id="first variation selector"),
        pytest.param("\ufe0f", id="last variation selector"),
        pytest.param("\U000e01ef", id="supplementary variation selector"),
        pytest.param("\u2800", id="braille without a dot"),
        pytest.param("\u200b", id="space of no width"),
        pytest.param("\u00ad", id="soft hyphen"),
        pytest.param("\u202e", id="turn of direction"),
    ],
)
def test_a_letter_that_shows_nothing_is_in_no_name(letter: str) -> None:
    assert not is_kept(name=letter)
    assert not is_kept(name=f"Walker{letter}")


@pytest.mark.parametrize(
    "name", ["한글", "ᄒ", "ភាសាខ្មែរ", "ᠮᠣᠩᠭᠣᠯ", "⠺⠁⠇⠅", "步行者", "Wanderer ☀"]
)
def test_a_name_may_be_of_any_script(name: str) -> None:
    assert is_kept(name=name)


def test_a_change_of_a_method_can_say_all_that_a_method_says() -> None:
    assert list(MethodChange.model_fields) == list(Method.model_fields)
    assert MethodChange().model_dump(exclude_unset=True) == {}
