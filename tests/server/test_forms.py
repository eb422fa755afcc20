"""Forms with a file, as browsers and scripts send them, and as nobody should."""

import pytest
from starlette.datastructures import Headers

from reverie_eval.server.errors import MalformedError
from reverie_eval.server.intake.uploads import parse_form

BOUNDARY = "----WebKitFormBoundary7MA4YWxkTrZu0gW"
FILE = 'Content-Disposition: form-data; name="file"; filename="a.json"'
TEXT = 'Content-Disposition: form-data; name="{}"'


def body(*parts: tuple[str, bytes], end: bytes = b"--\r\n") -> bytes:
    """Return a form of fields, each given by the lines before its content."""
    marked = [f"--{BOUNDARY}\r\n{head}\r\n\r\n".encode() + each for head, each in parts]
    return b"\r\n".join([*marked, f"--{BOUNDARY}".encode() + end])


def headers(boundary: str = BOUNDARY) -> Headers:
    """Return the headers of a form."""
    return Headers({"content-type": f"multipart/form-data; boundary={boundary}"})


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(b"[]", id="short"),
        pytest.param(b"", id="empty"),
        pytest.param(b"\r\n", id="an empty line"),
        pytest.param(b"\r\n--", id="the beginning of a boundary"),
        pytest.param(f"\r\n--{BOUNDARY[:-1]}".encode() * 99, id="all but a boundary"),
        pytest.param(f"x--{BOUNDARY}--".encode(), id="a boundary inside a line"),
        pytest.param(b"\x00\xff" * (1 << 20), id="bytes beyond a piece"),
        pytest.param(b"x" * ((1 << 16) - 225), id="a boundary across two pieces"),
    ],
)
def test_a_file_is_what_was_sent(content: bytes) -> None:
    texts, files = parse_form(headers(), body((TEXT.format("name"), b"Walker"), (FILE, content)))
    assert (texts, files) == ({"name": "Walker"}, {"file": (content, "a.json")})


def test_a_field_is_text_and_the_last_one_counts() -> None:
    parts = [(TEXT.format("name"), b"A"), (TEXT.format("name"), "Bél".encode())]
    assert parse_form(headers(), body(*parts)) == ({"name": "Bél"}, {})


@pytest.mark.parametrize(
    "sent",
    [
        pytest.param(b"\r\n" + body((FILE, b"[]")), id="an empty line before it"),
        pytest.param(body((FILE, b"[]"), end=b"--"), id="no end of the last line"),
        pytest.param(body((FILE, b"[]")) + b"anything", id="something behind it"),
        pytest.param(body((f"Content-Type: a/b\r\n{FILE}", b"[]")), id="another line"),
        pytest.param(body((FILE.replace("C", "c", 1), b"[]")), id="a small letter"),
    ],
)
def test_forms_that_are_written_differently(sent: bytes) -> None:
    assert parse_form(headers(), sent) == ({}, {"file": (b"[]", "a.json")})


@pytest.mark.parametrize(
    "sent",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(b"[]", id="no form"),
        pytest.param(body((FILE, b"[]"))[:-30], id="half of it"),
        pytest.param(body((FILE, f"\r\n--{BOUNDARY}X".encode())), id="a line like a boundary"),
        pytest.param(body((FILE, b""), (FILE, b"")), id="two files"),
        pytest.param(body(*[(TEXT.format("a"), b"")] * 28), id="28 fields"),
        pytest.param(body(("Content-Type: a/b", b"")), id="no disposition"),
        pytest.param(body((TEXT.format("a"), b"\xff")), id="another charset"),
        pytest.param(body((FILE, b"")).replace(b"a.json", b"\xe9.json"), id="a name in Latin-1"),
        pytest.param(body((f"{FILE}\r\nX: {'x' * 9000}", b"")), id="a long line"),
    ],
)
def test_forms_that_are_refused(sent: bytes) -> None:
    with pytest.raises(MalformedError, match=r"the form cannot be read: \w.+; send one file and "):
        parse_form(headers(), sent)


def test_twenty_fields_are_not_too_many() -> None:
    assert parse_form(headers(), body(*[(TEXT.format("a"), b"")] * 20)) == ({"a": ""}, {})


def test_a_form_without_a_boundary() -> None:
    with pytest.raises(MalformedError, match="the form cannot be read: "):
        parse_form(headers(boundary=""), body((FILE, b"")))
