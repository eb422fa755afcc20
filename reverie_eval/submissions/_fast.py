"""The fast reader: a valid file in any common form, in columns, without an object for each pose.

A parser that makes a list, a string and two numbers of each pose spends most of its time on these.
Here, msgspec checks the JSON but leaves trajectories as text, and numpy reads all of them at once.
The commas of poses tell where to look for their quotes and brackets. Without the letters and digits
of ids and numbers, the text of hops is ``[["",""],[""],...]``: as it is known to be valid JSON,
these marks tell the form of every element.

A file is read here if all records have the fields of the first one and nothing is wrong with any.
Everything else is declined and left to :mod:`reverie_eval.submissions._records`, which explains.
Both must give the same columns, notes and locations. This reader has no rules of its own: it asks
those of the other one about each different answer and each field that is not read.
"""

import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from itertools import chain, repeat
from operator import attrgetter, itemgetter
from struct import pack
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Raw

from reverie_eval.arrays import (
    LARGEST_OBJECT_ID,
    Array,
    BoolArray,
    FloatArray,
    IntArray,
    last_of,
    offsets_of,
    take_rows,
)
from reverie_eval.geometry import HEIGHT, WIDTH, view_angles
from reverie_eval.ground_truth import ID_LENGTH, ViewpointTable
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions._answers import (
    STRAIGHT_UP,
    Answer,
    GivenBoxes,
    box_columns,
    read_answer,
)
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._fields import (
    ANSWER_KEYS,
    ID_KEYS,
    INSTR_ID_KEY,
    PART_OF_ITEM,
    POINT_KEYS,
    RECORD_FIELDS,
    TRAJECTORY_KEY,
    answers_spelt_like,
    field_meant_by,
    fields_of,
)
from reverie_eval.submissions._predictions import (
    NO_BOXES,
    BoxAnswers,
    Numbering,
    Predictions,
    Records,
    Signs,
    look_like_degrees,
)
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.submissions._trajectories import DUETS_ID, MAX_POSES, PATH_KEY, have_types
from reverie_eval.tasks import BOX, ID_PREFIX, IMAGE_SIZE, ITEM_MARK, OBJECT, VIEW, Task

_LISTS = frozenset({list, tuple})
_NUMBERS = frozenset({float, int, np.float64, np.float32})
_INTEGERS = frozenset({int, np.int64, np.int32})

# Bytes that are read at once. The arrays of so many stay in the processor's cache, and memory is
# used again: the time for each episode and the memory do not grow with the file.
_PIECE = 3 << 18
# Bytes in which letters are counted at once, as comparing them makes an array of as many.
_PART = 1 << 18
_SPACE = rb"[ \t\r\n]*"
_FIRST_FIELD = re.compile(rb'%b\[%b\{%b("[^"\\]*")' % ((_SPACE,) * 3))
_MOST_FIELDS = 100
_PLAIN_NAME = re.compile(r'[^"\\:\x00-\x1f]+')
# Digits; Python refuses to read integers of about twice as many.
_LONG_NUMBER = 2048

_BOX_FIELDS = (BOX, VIEW, IMAGE_SIZE)
# In the place of a box where it only counts that there is one.
_ANY_BOX = (0.0, 0.0, 1.0, 1.0)
_NO_BOX = (np.nan,) * 4

# An id and a number: without it, the commas of a file need not be looked for.
_FIRST_POSE = re.compile(rb'\[\["\w{%d}", *[^"]' % ID_LENGTH)
# All that viewpoint ids, numbers and the space between them consist of; exponents have an "e".
_WITHOUT_MARKS = b"0123456789abcdef+-. \t\r\n"
_QUOTE, _COMMA, _OPEN, _CLOSE, _COLON, _BLANK, _MINUS = b'",[]: -'
_ZERO, _NINE = np.uint8(ord("0")), np.uint8(ord("9"))
# The count of numbers of a viewpoint that is not in a list.
_BARE = -1
# Bytes from one id to the next. A number in it fits a float if it has no positive exponent.
_LONGEST_GAP = 300


class _Declined(ValueError):  # noqa: N818  # it tells nobody of an error
    """The file is not valid, or has an unusual form."""


class _Records(NamedTuple):
    """The records of a document."""

    text: bytes
    """A list of them, as JSON."""
    n_colons: int
    """How many of them it has if it is the whole document."""
    differences: Mapping[str, int]
    keys: Sequence[str] = ()
    """Their keys, if they have any."""
    instr_ids: Sequence[str] = ()
    """Their ids, if they are the trajectories of items."""
    locate: Callable[[int], RecordLocation] | None = None


class _Form(NamedTuple):
    """How the records of a file are read, by the fields of the first one."""

    decode: Callable[[bytes], list[Any]]
    """Decodes records with these fields and no others."""
    attributes: Mapping[str, str]
    """Names by field in a decoded record; its id and trajectory are ``id`` and ``walk``."""
    n_fields: int
    id_key: str
    """The field with the id; empty if the record has none."""
    answer_keys: Sequence[str]
    has_boxes: bool
    """Whether the records have a field for a box."""
    other_keys: Sequence[str]
    """Fields whose values are not looked at."""
    ignored: Sequence[str]
    """Fields that the task does not have."""


class _Walks(NamedTuple):
    """The trajectories of some records."""

    stop_angles: FloatArray
    """Shape (n_records, 2): heading and elevation of the last pose, NaN if there are none. If they
    are not needed exactly, 0 for angles that are surely within a turn, and infinite for others."""
    viewpoint: IntArray
    """Shape (n_viewpoints,): the number of each viewpoint id."""
    length: IntArray
    """Shape (n_records,): viewpoints of each trajectory."""
    n_elements: IntArray
    """Shape (n_records,): elements of each trajectory: poses, hops or bare viewpoints."""
    n_viewpoints: IntArray
    """Shape (n_elements,): viewpoints of each element."""
    n_numbers: IntArray
    """Shape (n_elements,): numbers of each element, or ``_BARE``."""


class _Part(NamedTuple):
    """The columns of some records."""

    instr_ids: Sequence[str]
    predicted_object: IntArray
    answer_is_text: BoolArray
    has_leading_zeros: BoolArray
    point: FloatArray
    box: FloatArray
    """Shape (n_records, 7): a box, its image's size and its view, NaN for none. Without the field,
    shape (n_records, 0)."""
    n_colons: IntArray
    """Shape (1,): the colons of what was decoded."""
    walks: _Walks


def read_fast(
    content: bytes, task: Task, viewpoints: ViewpointTable, *, answers_only: bool = False
) -> Predictions | None:
    """Read a valid file; return None for one that is not valid, or has an unusual form."""
    try:
        records = _find_records(content, task)
        return _read(records, task, viewpoints, answers_only=answers_only)
    except (_Declined, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def _require(condition: object) -> None:
    if not condition:
        raise _Declined


# From a document to a list of records.


class _Item(msgspec.Struct, forbid_unknown_fields=True, gc=False):
    instr_id: str | int
    trajectory: Raw


_decode_lines = msgspec.json.Decoder(Raw).decode_lines
_decode_keyed = msgspec.json.Decoder(dict[str, Raw]).decode
_decode_items = msgspec.json.Decoder(list[_Item]).decode
_decode_lists = msgspec.json.Decoder(list[list[Raw]]).decode
_decode_fields = msgspec.json.Decoder(list[dict[str, Raw]]).decode
_decode_numbers = msgspec.json.Decoder(list[float]).decode


def _find_records(content: bytes, task: Task) -> _Records:
    n_colons = _count(_COLON, content)
    first = content[:1] if content[:1] in (b"[", b"{") else content.lstrip()[:1]
    if first == b"[":
        return _split_items(content) if task.has_items else _Records(content, n_colons, {})
    _require(first == b"{" and not task.has_items)
    try:
        keyed = _decode_keyed(content)
    except msgspec.DecodeError:  # which ends at the second of several lines
        return _Records(_list_of(_decode_lines(content)), n_colons, {})
    # Fields are keys in a table of columns.
    _require(RECORD_FIELDS.isdisjoint(keyed))
    count = len(keyed)
    return _Records(_list_of(keyed.values()), n_colons - count, {"keyed": count}, list(keyed))


def _split_items(content: bytes) -> _Records:
    """Return the trajectories of items as records of their own."""
    items = _decode_items(content)
    texts = [bytes(item.trajectory) for item in items]
    is_list = [text.startswith(b"[") for text in texts]
    trajectories = _decode_lists(
        _list_of(each if it else _list_of([each]) for each, it in zip(texts, is_list, strict=True))
    )
    text = _list_of(chain.from_iterable(trajectories))
    seen: Counter[str] = Counter()
    instr_ids, locations = [], []
    for row, (item, parts) in enumerate(zip(items, trajectories, strict=True)):
        name = str(item.instr_id)
        _require(parts and ITEM_MARK not in name and not DUETS_ID.fullmatch(name))
        for index in range(len(parts)):
            instr_ids.append(f"{name}{ITEM_MARK}{seen[name]}")
            locations.append(RecordLocation(row, trajectory=index))
            seen[name] += 1
    n_colons = _count(_COLON, content) - 2 * len(items)
    differences = {"single trajectories": is_list.count(False)}
    return _Records(text, n_colons, differences, (), instr_ids, locations.__getitem__)


def _count(letter: int, text: bytes | Array) -> int:
    """Return how often a letter occurs, five times as fast as `bytes.count`."""
    letters = np.frombuffer(text, np.uint8)
    parts = (letters[begin : begin + _PART] for begin in range(0, len(letters), _PART))
    return sum(int(np.count_nonzero(part == letter)) for part in parts)


def _list_of(texts: Iterable[Any]) -> bytes:
    return b"[%b]" % b",".join(texts)


# From a list of records to columns.


def _read(
    records: _Records,
    task: Task,
    viewpoints: ViewpointTable,
    *,
    answers_only: bool,
    exact_angles: bool = False,
) -> Predictions:
    text, keys = records.text, records.keys
    first = _FIRST_FIELD.match(text)
    if first is None:
        raise _Declined
    # An object inside a record rarely begins with the field that records begin with.
    between = re.compile(rb"\}%b,%b(?=\{%b%b)" % (*(_SPACE,) * 3, re.escape(first[1])))
    end = between.search(text)
    beginning = text if end is None else text[: end.start() + 1] + b"]"
    form = _form_of(tuple(_decode_fields(beginning)[0]), task, has_keys=bool(keys))
    has_answers = form.has_boxes or bool(form.answer_keys)
    _require(has_answers or not answers_only)
    log = ReadingLog()
    exact_angles = exact_angles or form.has_boxes
    read = partial(_read_piece, form, task, viewpoints, log, exact_angles=exact_angles)
    parts = map(read, map(form.decode, _pieces(text, between)))
    part = _Part(*map(_join, zip(*parts, strict=True)))
    # Where a field or a key comes twice, the parser drops a value, and with it at least one colon.
    _require(records.n_colons == part.n_colons.sum())
    walks = part.walks
    has_degrees = look_like_degrees(walks.stop_angles)
    if has_degrees and not exact_angles:
        return _read(records, task, viewpoints, answers_only=answers_only, exact_angles=True)
    # A record's own id must be its key.
    _require(not (keys and form.id_key) or part.instr_ids == keys)
    instr_ids = records.instr_ids or keys or part.instr_ids
    n_prefixed = 0
    if ID_PREFIX in "".join(instr_ids):
        n_prefixed = sum(map(str.startswith, instr_ids, repeat(ID_PREFIX)))
        instr_ids = [each.removeprefix(ID_PREFIX) for each in instr_ids]
    log.differences.update(records.differences)
    log.differences["prefixed"] += n_prefixed
    log.differences["navigation only"] += len(instr_ids) * (not has_answers and task.has_targets)
    boxes = NO_BOXES
    if form.has_boxes:
        nowhere = np.full_like(walks.stop_angles, np.nan)
        boxes = _box_columns(part.box, nowhere if answers_only else walks.stop_angles, log)
    if not answers_only:
        _note_elements(walks, log)
    pose_locations, continues_hop = _pose_locations(walks)
    locate = records.locate
    if keys:
        locate = partial(_locate_key, keys, form.id_key or task.id_field.name)
    predictions = Predictions(
        instr_ids=instr_ids,
        viewpoint=walks.viewpoint,
        distinct_ids=viewpoints.ids,
        offsets=offsets_of(walks.length),
        predicted_object=part.predicted_object,
        has_degrees=has_degrees,
        answer_is_text=part.answer_is_text,
        has_leading_zeros=part.has_leading_zeros,
        boxes=boxes,
        is_navigation_only=not has_answers,
        point=part.point if task.has_items else None,
        locate=locate,
        pose_locations=pose_locations,
        continues_hop=continues_hop,
        read_as=log.read_as(),
        ignored_fields=dict.fromkeys(form.ignored, len(instr_ids)),
        differences=log.differences,
        signs=Signs(
            id_key="instr_id" if task.has_items else form.id_key,
            has_items=task.has_items,
            has_points=task.has_items,
            has_answers=bool(len(boxes.row) or (part.predicted_object != ABSTAINED).any()),
        ),
    )
    return predictions.without_trajectories() if answers_only else predictions


def _locate_key(keys: Sequence[str], id_key: str, row: int) -> RecordLocation:
    return RecordLocation(row, keys[row], id_key=id_key)


def _join(columns: Sequence[Any]) -> Any:
    if isinstance(columns[0], np.ndarray):
        return np.concatenate(columns)
    if isinstance(columns[0], _Walks):
        return _Walks(*map(_join, zip(*columns, strict=True)))
    return list(chain.from_iterable(columns))


def _pieces(text: bytes, between: re.Pattern[bytes]) -> Iterator[bytes]:
    """Cut a list of records into shorter lists.

    If all of them are lists of records, so is the whole. Where a cut is not between records after
    all, the lists on either side of it are not JSON.
    """
    # Joined as a view: a slice would be copied first.
    view, begin, opening = memoryview(text), 0, b""
    while cut := between.search(text, begin + _PIECE):
        yield b"".join((opening, view[begin : cut.start() + 1], b"]"))
        begin, opening = cut.end(), b"["
    yield b"".join((opening, view[begin:]))


@lru_cache(maxsize=64)
def _form_of(names: tuple[str, ...], task: Task, *, has_keys: bool) -> _Form:
    """Return how records with these fields are read, unless their names raise questions."""
    known = PART_OF_ITEM if task.has_items else fields_of(task)
    walk_key = PATH_KEY if task.has_items else TRAJECTORY_KEY
    ids = [name for name in names if name in ID_KEYS]
    answers = [key for key in ANSWER_KEYS if key in names and known.has_answers]
    ignored = [name for name in names if name not in known.all and name != walk_key]
    _require(walk_key in names and len(names) <= _MOST_FIELDS)
    _require(all(map(_PLAIN_NAME.fullmatch, names)))
    if task.has_items:
        _require(set(names) == {walk_key, *POINT_KEYS})
    else:
        _require(len(ids) == 1 or (has_keys and not ids))
        _require(set(ids) <= set(task.id_field.names))
    # A name that resembles a known one is ignored where the known one has a value.
    _require({field_meant_by(name, known) for name in ignored} <= {None, known.id.name, walk_key})
    has_boxes = known.has_answers and BOX.name in names
    _require(not (known.has_answers and any(map(answers_spelt_like, ignored))))
    types: dict[str, Any] = dict.fromkeys(names, Raw)
    types |= dict.fromkeys(ids, str | int if task.has_numbers else str)
    types |= dict.fromkeys(answers, OBJECT.type | str | None)
    types |= {field.name: field.type for field in _BOX_FIELDS if has_boxes and field.name in names}
    types |= dict.fromkeys(POINT_KEYS if task.has_items else (), float | list[float] | None)
    attributes = {name: f"field_{index}" for index, name in enumerate(names)}
    attributes |= {walk_key: "walk"} | dict.fromkeys(ids, "id")
    record = msgspec.defstruct(
        "Record",
        [(attributes[name], kind) for name, kind in types.items()],
        rename={attribute: name for name, attribute in attributes.items()},
        forbid_unknown_fields=True,
        gc=False,
    )
    return _Form(
        decode=msgspec.json.Decoder(list[record]).decode,  # type: ignore[valid-type]
        n_fields=len(names),
        id_key=ids[0] if ids else "",
        attributes={name: attributes[name] for name in names if name not in (walk_key, *ids)},
        answer_keys=answers,
        has_boxes=has_boxes,
        other_keys=[name for name, kind in types.items() if kind is Raw and name != walk_key],
        ignored=ignored,
    )


def _read_piece(
    form: _Form,
    task: Task,
    viewpoints: ViewpointTable,
    log: ReadingLog,
    records: list[Any],
    *,
    exact_angles: bool,
) -> _Part:
    n_records = len(records)
    # Three times as fast as `attrgetter`, which takes the others.
    text = b",".join([*[record.walk for record in records], b""])
    instr_ids = [record.id for record in records] if form.id_key else []
    columns = {name: list(map(attrgetter(it), records)) for name, it in form.attributes.items()}
    # Or the piece that they were decoded from would be kept while trajectories are read.
    records.clear()
    others = b",".join(chain.from_iterable(columns[name] for name in form.other_keys))
    # The parser does not look into texts and numbers that it skips.
    others.decode()
    _require(not _has_long_number(others))
    n_colons = np.array([n_records * form.n_fields + others.count(b":")])
    if task.has_numbers:
        instr_ids = list(map(str, instr_ids))
    point = box = np.empty((n_records, 0))
    if task.has_items:
        point = _read_points([columns[key] for key in POINT_KEYS], log)
    given = {key: columns[key] for key in form.answer_keys}
    if form.has_boxes:
        box = _read_boxes(columns)
        given[BOX.name] = [each and True for each in columns[BOX.name]]
    answers = _read_answers(given, n_records, log)
    walks = _read_walks(text, n_records, viewpoints, exact_angles=exact_angles)
    return _Part(instr_ids, *answers, point, box, n_colons, walks)


def _has_long_number(text: bytes) -> bool:
    # A number of twice as many digits has a whole block of them, wherever it begins.
    blocks = range(0, len(text) - _LONG_NUMBER + 1, _LONG_NUMBER)
    return any(text[begin : begin + _LONG_NUMBER].isdigit() for begin in blocks)


# Answers.


def _read_answers(
    columns: Mapping[str, list[Any]], n_records: int, log: ReadingLog
) -> tuple[IntArray, BoolArray, BoolArray]:
    no = np.zeros(n_records, dtype=np.bool_)
    if not columns:
        return np.full(n_records, ABSTAINED), no, no
    keys, (first, *_) = tuple(columns), columns.values()
    if keys == ANSWER_KEYS[:1]:
        # Nearly always: whole numbers under the official name differ in nothing.
        with suppress(TypeError):  # of text and null
            return np.array(array("q", first)), no, no
    different = Numbering[tuple[Any, ...]]()
    index = different.numbers(zip(*columns.values(), strict=True))
    answers, differences = zip(*map(partial(_read_answer, keys), different), strict=True)
    for number, each in zip(np.bincount(index).tolist(), differences, strict=True):
        for key, times in each:
            log.differences[key] += number * times
    objects, are_texts, have_zeros = map(np.array, list(zip(*answers, strict=True))[:3])
    return objects[index], are_texts[index], have_zeros[index]


@lru_cache(maxsize=1 << 13)
def _read_answer(
    keys: tuple[str, ...], values: tuple[Any, ...]
) -> tuple[Answer, Sequence[tuple[str, int]]]:
    """Return the answer in these fields, and how often each difference occurs in it."""
    log = ReadingLog()
    record = dict(zip(keys, values, strict=True))
    if record.get(BOX.name):
        # Any box and view serve: what is in them is read with all others.
        record |= {BOX.name: _ANY_BOX, VIEW.name: 0}
    answer = read_answer(RecordLocation(0), record, None, log)
    _require(not log.all_problems())
    return answer, [(key, times) for key, times in log.differences.items() if times]


def _read_boxes(columns: Mapping[str, list[Any]]) -> FloatArray:
    boxes = columns[BOX.name]
    table = np.full((len(boxes), 7), (*_NO_BOX, WIDTH, HEIGHT, np.nan))
    table[:, :4] = _table([box or _NO_BOX for box in boxes], 4)
    if IMAGE_SIZE.name in columns:
        sizes = columns[IMAGE_SIZE.name]
        table[:, 4:6] = _table([size or (WIDTH, HEIGHT) for size in sizes], 2)
    if VIEW.name in columns:
        table[:, 6] = np.array(columns[VIEW.name], dtype=np.float64)  # NaN for null
    return table


def _table(rows: Sequence[Sequence[float]], width: int) -> FloatArray:
    return _floats(chain.from_iterable(rows)).reshape(-1, width)


def _floats(values: Iterable[float]) -> FloatArray:
    # Packed in one call; `np.array` would take twice as long, and more for rows.
    numbers = tuple(values)
    return np.frombuffer(pack(f"{len(numbers)}d", *numbers))


def _box_columns(box: FloatArray, stop_angles: FloatArray, log: ReadingLog) -> BoxAnswers:
    row = np.flatnonzero(~np.isnan(box[:, 0]))
    xywh, image_size, view = np.split(box.take(row, axis=0), [4, 6], axis=1)
    stop_angles, has_view = stop_angles.take(row, axis=0), ~np.isnan(view)
    camera = np.where(has_view, view_angles(np.where(has_view, view, 0)[:, 0]), stop_angles)
    _require((np.abs(camera[:, 1]) <= STRAIGHT_UP).all())  # NaN is not
    boxes = box_columns(GivenBoxes(row, xywh, image_size, camera, stop_angles), log)
    _require(not log.all_problems())
    return boxes


def _read_points(columns: Sequence[list[Any]], log: ReadingLog) -> FloatArray:
    values = list(chain.from_iterable(zip(*columns, strict=True)))
    listed = [value for value in values if isinstance(value, list)]
    _require(all(len(value) == 1 for value in listed))
    plain = chain.from_iterable(v if isinstance(v, list) else [v] for v in values)
    point = np.array(list(plain), dtype=np.float64).reshape(-1, len(columns))  # NaN for null
    is_none = np.isnan(point)
    _require(np.isfinite(point[~is_none]).all() and (is_none[:, 0] == is_none[:, 1]).all())
    log.differences["listed angles"] += len(listed)
    log.differences["no point"] += int(is_none[:, 0].sum())
    return point


# Trajectories.


class _Elements(NamedTuple):
    """The elements of some trajectories, as they are found in their text."""

    begin: IntArray
    """Shape (n_viewpoints,): where each id begins."""
    length: IntArray
    """This and the next three are as in :class:`_Walks`."""
    n_elements: IntArray
    n_viewpoints: IntArray
    n_numbers: IntArray
    n_brackets: int
    """Brackets in the text."""
    stop_commas: IntArray | None = None
    """Shape (n_records, 2): the commas before heading and elevation of each last pose; None if they
    have not been looked for."""


def _read_walks(
    text: bytes, n_records: int, viewpoints: ViewpointTable, *, exact_angles: bool
) -> _Walks:
    """Read trajectories from their JSON text, with a comma behind each."""
    elements = _find_poses(text, n_records) or _find_elements(text, n_records)
    begin, length, n_elements, n_viewpoints, n_numbers, n_brackets, stop_commas = elements
    _require(length.min() > 0 and n_elements.max() <= MAX_POSES)
    ids = np.ndarray(len(text) - ID_LENGTH, f"V{ID_LENGTH}", text, strides=1)[begin]
    viewpoint = viewpoints.find(ids)
    if viewpoint is None:
        raise _Declined
    _check_numbers(text, begin, _count_letters(ids.view(np.uint8)) + n_brackets)
    if stop_commas is None or exact_angles:
        offsets = offsets_of(length)
        count = np.repeat(n_numbers, n_viewpoints)[last_of(offsets)]
        # Numbers end a trajectory, unless an empty hop comes behind them.
        _require((count == n_numbers[last_of(offsets_of(n_elements))]).all())
        stop_angles = _read_angles(text, begin, offsets, count)
    else:
        is_small = _are_within_turn(text, stop_commas)
        stop_angles = np.repeat(np.where(is_small, 0, np.inf), 2).reshape(-1, 2)
    return _Walks(stop_angles, viewpoint, length, n_elements, n_viewpoints, n_numbers)


def _find_poses(text: bytes, n_records: int) -> _Elements | None:
    """Find elements that are all a list of an id and two numbers, as in most files.

    In valid JSON these brackets make poses of all, if there are no others: that is for
    :func:`_check_numbers` to see.
    """
    if not _FIRST_POSE.match(text):
        return None
    letters = np.frombuffer(text, np.uint8)
    found = np.flatnonzero(letters == _COMMA)
    if 2 * len(found) != 3 * np.count_nonzero(letters == _QUOTE):
        return None
    # Behind the id, behind the heading, and behind the pose.
    commas = found.reshape(-1, 3)
    begin, end = commas[:, 0] - ID_LENGTH - 1, commas[:, 2]
    last = np.flatnonzero(letters[end - 2] == _CLOSE)
    first = np.append(0, last[:-1] + 1)
    are_poses = (
        len(last) == n_records
        and (letters[begin - 2] == _OPEN).all()
        and (letters[begin - 1] == _QUOTE).all()
        and (letters[begin + ID_LENGTH] == _QUOTE).all()
        and (letters[end - 1] == _CLOSE).all()
        and (letters[begin[first] - 3] == _OPEN).all()
    )
    if not are_poses:
        return None
    length, ones = last - first + 1, np.ones(len(begin), dtype=np.int8)
    n_brackets = 2 * (len(begin) + n_records)
    return _Elements(begin, length, length, ones, 2 * ones, n_brackets, commas[last, :2])


def _find_elements(text: bytes, n_records: int) -> _Elements:
    """Find elements of any form.

    All of an element shows in the marks but its numbers, which show in the commas between.
    """
    written = text.translate(None, _WITHOUT_MARKS)
    is_bare = b"[[" not in written
    if is_bare:  # read as if each viewpoint were a list
        written = written.replace(b'""', b'[""]')
    marks = np.frombuffer(written, np.uint8)
    is_open, is_close = marks == _OPEN, marks == _CLOSE
    # Only at the end of a trajectory are two lists closed at once, unless one is nested too deeply.
    last = np.flatnonzero(is_close[:-1] & is_close[1:]) + 1
    _require(len(last) == n_records)
    is_open[np.append(0, last[:-1] + 2)] = is_close[last] = False
    opens, closes = np.flatnonzero(is_open), np.flatnonzero(is_close)
    _require(len(opens) == len(closes) and (opens < closes).all())
    _require((closes[:-1] < opens[1:]).all())
    spans = closes - opens
    # A comma or the end is behind every element, and a beginning before the first.
    _require(len(marks) == (spans + 2).sum() + 2 * n_records)
    is_quote = marks == _QUOTE
    n_commas, n_brackets = np.count_nonzero(marks == _COMMA), 2 * (len(opens) + n_records)
    _require(len(marks) == np.count_nonzero(is_quote) + n_commas + n_brackets)
    quotes_before = np.cumsum(is_quote, dtype=np.int32)
    n_viewpoints = (quotes_before[closes] - quotes_before[opens]) // 2
    n_numbers = spans - 3 * n_viewpoints
    is_empty = spans == 1
    if is_empty.any():
        # What looks empty may be a lone number.
        _require(np.count_nonzero(is_empty) == text.count(b"[]"))
        n_numbers[is_empty] = 0
    is_pose = (n_viewpoints == 1) & (n_numbers > 1) & is_quote[opens + 1]
    _require((is_pose | (n_numbers == 0)).all())
    if is_bare:
        n_numbers[:], n_brackets = _BARE, 2 * n_records
    begin, end = np.flatnonzero(np.frombuffer(text, np.uint8) == _QUOTE).reshape(-1, 2).T
    _require((end - begin == ID_LENGTH + 1).all())
    n_elements = np.diff(np.searchsorted(closes, last), prepend=0)
    length = np.add.reduceat(n_viewpoints, offsets_of(n_elements)[:-1])
    return _Elements(begin + 1, length, n_elements, n_viewpoints, n_numbers, n_brackets)


def _check_numbers(text: bytes, begin: IntArray, n_letters: int) -> None:
    """Decline what may not be a number that fits a float; so many letters are not in numbers."""
    _require(len(text) - begin[-1] <= _LONGEST_GAP)
    _require((begin[1:] - begin[:-1]).max(initial=0) <= _LONGEST_GAP)
    n_exponents = _count_letters(np.frombuffer(text, np.uint8)) - n_letters
    if n_exponents:
        # A negative exponent makes a number smaller; ids have no minus sign.
        _require(n_exponents == text.count(b"e-"))


def _count_letters(text: Array) -> int:
    """Count letters and brackets, which all come behind the digits."""
    return int(np.count_nonzero(text > _NINE))


def _are_within_turn(text: bytes, commas: IntArray) -> BoolArray:
    """Whether the two numbers behind these commas are surely angles in radians."""
    letters = np.frombuffer(text, np.uint8)
    angle = commas + 1 + (letters[commas + 1] == _BLANK)
    digit = angle + (letters[angle] == _MINUS)
    # Five or less before the point, whatever is behind it; exponents are negative.
    is_small = (letters[digit] - _ZERO <= 5) & (letters[digit + 1] - _ZERO > 9)
    return np.asarray(is_small[:, 0] & is_small[:, 1])


def _read_angles(text: bytes, begin: IntArray, offsets: IntArray, count: IntArray) -> FloatArray:
    """Return the first two of so many numbers behind the last id of each trajectory; NaN for none.

    Brackets are there too, and a comma before each number. Any other one makes the text invalid.
    """
    angles, rows = np.full((len(count), 2), np.nan), np.flatnonzero(count > 0)
    if rows.size:
        behind = begin[last_of(offsets)[rows]] + ID_LENGTH + 1
        ends = np.column_stack([behind, np.append(begin - 1, len(text))[offsets[1:][rows]]])
        between = take_rows(np.arange(0, 2 * len(rows), 2), ends.ravel())
        numbers = np.frombuffer(text, np.uint8)[between].tobytes().translate(None, b"[] \t\r\n")
        # Between two trajectories is one comma more.
        read = _floats(_decode_numbers(b"[0%b0]" % numbers.replace(b",,", b",")))
        first = offsets_of(count[rows])[:-1] + 1
        angles[rows] = np.column_stack([read[first], read[first + 1]])
    return angles


# Notes and locations.


def _note_elements(walks: _Walks, log: ReadingLog) -> None:
    """Count how the elements of trajectories differ from poses."""
    n_viewpoints, n_numbers = walks.n_viewpoints, walks.n_numbers
    is_hop = n_numbers == 0
    if is_hop.any():
        is_other = is_hop & (n_viewpoints != 1)
        per_record = np.logical_or.reduceat(is_other, offsets_of(walks.n_elements)[:-1])
        log.differences["hops"] += int(per_record.sum())
        log.differences["empty hops"] += int((n_viewpoints == 0).sum())
        log.differences["long hops"] += int((n_viewpoints > 1).sum())
        log.differences["no angles"] += int(n_viewpoints[is_hop].sum())
    log.differences["bare viewpoints"] += int((n_numbers == _BARE).sum())
    log.differences["extra numbers"] += int((n_numbers > 2).sum())


def _pose_locations(walks: _Walks) -> tuple[IntArray, BoolArray] | tuple[None, None]:
    """Return where viewpoints are in their trajectories, and whether each continues a hop.

    None if every element is a list of one viewpoint.
    """
    n_viewpoints = walks.n_viewpoints
    is_bare = walks.n_numbers == _BARE
    if (n_viewpoints == 1).all() and not is_bare.any():
        return None, None
    element = np.arange(len(n_viewpoints)) - np.repeat(
        offsets_of(walks.n_elements)[:-1], walks.n_elements
    )
    step = np.arange(len(walks.viewpoint)) - np.repeat(offsets_of(n_viewpoints)[:-1], n_viewpoints)
    step[np.repeat(is_bare, n_viewpoints)] = -1
    return np.column_stack([np.repeat(element, n_viewpoints), step]), step > 0


# Python objects.


def convert_official(submission: Records, *, has_answers: bool = True) -> Predictions | None:
    """Read Python objects in the plain official form; return None if they have any other form.

    Angles and object ids may be numpy numbers, which agents often produce.
    """
    plain = _plain_columns(submission, [INSTR_ID_KEY, TRAJECTORY_KEY, *ANSWER_KEYS[:has_answers]])
    if plain is None:
        return None
    instr_ids, trajectories, viewpoint_ids, angles, given = plain
    answers = given[0] if given else [ABSTAINED] * len(instr_ids)
    if max(map(len, trajectories)) > MAX_POSES:
        return None
    try:
        angle = np.array(angles, dtype=np.float64).T
        predicted_object = np.array(answers, dtype=np.int64)
    except OverflowError:  # an integer that does not fit: the careful reader reports it
        return None
    is_object = (predicted_object >= ABSTAINED) & (predicted_object <= LARGEST_OBJECT_ID)
    if not (np.isfinite(angle).all() and is_object.all()) or any(
        map(str.startswith, instr_ids, repeat(ID_PREFIX))
    ):
        return None
    offsets = offsets_of(np.array(list(map(len, trajectories))))
    return Predictions(
        instr_ids=instr_ids,
        **Numbering.columns(viewpoint_ids),
        offsets=offsets,
        predicted_object=predicted_object,
        has_degrees=look_like_degrees(angle[offsets[1:] - 1]),
        # Integers alone come this far: text takes the careful reader.
        answer_is_text=np.zeros(len(instr_ids), dtype=np.bool_),
        has_leading_zeros=np.zeros(len(instr_ids), dtype=np.bool_),
        is_navigation_only=not has_answers,
        signs=Signs(has_answers=bool((predicted_object != ABSTAINED).any())),
    )


def _plain_columns(submission: Any, fields: Sequence[str]) -> Sequence[Sequence[Any]] | None:
    """Return ids, trajectories, viewpoint ids, angles and answers, if all have exactly their types.

    Comparing sets of types takes C loops only. Subclasses do not pass, as they may behave in their
    own way; the careful reader reads them.
    """
    if not (submission and have_types([submission], _LISTS) and have_types(submission, {dict})):
        return None
    # Keys in another order are equal, and a missing or further one is not.
    if any(record.keys() != set(fields) for record in submission):
        return None
    columns = (list(map(itemgetter(field), submission)) for field in fields)
    instr_ids, trajectories, *answers = columns
    if not (
        have_types(instr_ids, {str})
        and have_types(trajectories, _LISTS)
        and all(have_types(each, _INTEGERS) for each in answers)
    ):
        return None
    poses = list(chain.from_iterable(trajectories))
    if not (all(trajectories) and have_types(poses, _LISTS) and set(map(len, poses)) == {3}):
        return None
    viewpoint_ids, *angles = zip(*poses, strict=True)
    if not (have_types(viewpoint_ids, {str}) and have_types(chain(*angles), _NUMBERS)):
        return None
    return instr_ids, trajectories, viewpoint_ids, angles, answers
