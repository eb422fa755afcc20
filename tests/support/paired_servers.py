"""Two servers that differ in the solution of the private split alone.

Whatever somebody asks them, they have to say the same, byte for byte, apart from scores and what
is derived from the ground truth as a whole: its fingerprint, and the signature of a receipt.
"""

import json
import re
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from random import Random
from typing import Any

import httpx
import numpy as np
import pytest

from reverie_eval.arrays import Array
from reverie_eval.ground_truth import Bundle, pack_texts
from reverie_eval.schemas.service import BoardResult
from reverie_eval.server.http.callers import COOKIE
from reverie_eval.server.store.tables import Submission
from tests.support.serving import OTHER_BOARDS, PRIVATE, OpenServer, Serving, adjusted, settings_of
from tests.support.signing import payload_in, receipt_in
from tests.support.visiting import FIELD

PLENTY = {"day": 1_000_000, "month": 1_000_000, "year": 1_000_000}
_SCORED = "scores"
"""The key of what may differ."""
_SHOWN = 12
"""Digits of a fingerprint in the signature of scores."""
_MADE_UP = 0.4321
_TIMINGS = re.compile(rb"^(reverie_eval_request_seconds|\w+_created).*\n", re.MULTILINE)
"""What metrics say of the time."""
_VARIABLE_HEADERS = frozenset({"content-length"})
"""Headers that follow from the digits of scores."""


def with_other_answers(bundle: Bundle, seed: int) -> Bundle:
    """Return a split whose public part is the same, and everything else is drawn anew.

    Other objects are visible in other views with other boxes, paths end elsewhere at another
    target, categories are others.
    """
    random, arrays = Random(seed), bundle.arrays
    seen = [
        (viewpoint, object_id)
        for viewpoint in range(len(arrays["viewpoint_id"]))
        for object_id in sorted(random.sample(range(400), random.randint(1, 9)))
    ]
    shown = [
        (candidate, view)
        for candidate in range(len(seen))
        for view in sorted(random.sample(range(36), random.randint(1, 4)))
    ]
    paths = [_walk(random, bundle, start) for start in arrays["task_start"].tolist()]
    at = {viewpoint: [] for viewpoint, _ in seen}  # type: dict[int, list[int]]
    for viewpoint, object_id in seen:
        at[viewpoint].append(object_id)
    changed = {
        "task_target": np.array([random.choice(at[path[-1]]) for path in paths]),
        "path": np.concatenate([np.array(path) for path in paths]),
        "path_offsets": np.cumsum([0, *map(len, paths)]),
        "candidate_viewpoint": np.array([viewpoint for viewpoint, _ in seen]),
        "candidate_object": np.array([object_id for _, object_id in seen]),
        "candidate_distance": np.array([random.uniform(0, 6) for _ in seen]),
        "target_position": np.array([[random.uniform(-9, 9) for _ in "xyz"] for _ in paths]),
        "box_candidate": np.array([candidate for candidate, _ in shown]),
        "box_view": np.array([view for _, view in shown]),
        "box_xywh": np.array([_box(random) for _ in shown]),
    }
    texts = {
        **bundle.texts,
        "target_category": _categories(random, len(paths)),
        "candidate_category": _categories(random, len(seen)),
    }
    header = bundle.header
    origin = header.split, header.dataset, header.sources
    return Bundle.build(*origin, {**arrays, **changed}, bundle.other_splits, texts=texts)


def _categories(random: Random, count: int) -> Array:
    return pack_texts([f"category {random.randrange(50)}" for _ in range(count)])


def _walk(random: Random, bundle: Bundle, start: int) -> list[int]:
    """Return a path that ends at another viewpoint of the scan, if there is one."""
    scans = bundle.arrays["viewpoint_scan"]
    others = np.flatnonzero(scans == scans[start]).tolist()
    return [start, *random.sample(others, min(len(others), random.randint(1, 4)))]


def _box(random: Random) -> tuple[int, int, int, int]:
    width, height = random.randint(10, 300), random.randint(10, 300)
    return random.randint(0, 640 - width), random.randint(0, 480 - height), width, height


@dataclass
class Identifiers:
    """Stands for the module ``secrets``, so that two servers give out the same ids."""

    serial: Iterator[int] = field(default_factory=count)

    def token_hex(self, size: int) -> str:
        """Return the next number in this many bytes."""
        return next(self.serial).to_bytes(size, "big").hex()

    def token_urlsafe(self, size: int) -> str:
        """Return the next number as text that is long enough."""
        return self.token_hex(size)


@dataclass
class Twins:
    """Two servers that are asked the same."""

    servers: tuple[Serving, Serving]
    identifiers: tuple[Identifiers, Identifiers] = field(
        default_factory=lambda: (Identifiers(), Identifiers())
    )
    asked: int = 0
    """Requests so far, each to both."""
    statuses: dict[int, int] = field(default_factory=dict)

    def ask(
        self, who: str | None, method: str, path: str, *, has_scores: bool = False, **content: Any
    ) -> httpx.Response:
        """Send a request to both, check that the replies are the same, and return the first.

        With ``has_scores``, scores are left out of the comparison: of JSON alone, by their keys.
        """
        left, right = (
            self._ask(server, identifiers, who, method, path, **content)
            for server, identifiers in zip(self.servers, self.identifiers, strict=True)
        )
        self.asked += 1
        self.statuses[left.status_code] = self.statuses.get(left.status_code, 0) + 1
        assert left.status_code == right.status_code, (method, path, left.text, right.text)
        assert left.status_code < 500, (method, path, left.text)
        assert self._shown(left, 0, has_scores) == self._shown(right, 1, has_scores), (method, path)
        return left

    def cookie_of(self, who: str) -> Mapping[str, str]:
        """Sign somebody in with a browser, and return its header."""
        token = self.servers[0].tokens[who]
        reply = self.ask(None, "POST", "/sign-in", data={"token": token})
        return {"Cookie": f"{COOKIE}={reply.cookies[COOKIE]}"}

    def csrf_token(self, cookie: Mapping[str, str]) -> str:
        """Return what our pages put into the forms of a browser's session."""
        (csrf_token, *_) = FIELD.findall(self.ask(None, "GET", "/team", headers=cookie).text)
        return str(csrf_token)

    def give_same_scores(self, submission_id: str) -> None:
        """Give a result the same made-up scores on both, so that pages can be compared."""
        for server in self.servers:
            with server.state.database.writing() as session:
                row = session.get_one(Submission, submission_id)
                for name, result in row.results.items():
                    scores = dict.fromkeys(result.report.scores, _MADE_UP)
                    report = result.report.model_copy(update={"scores": scores})
                    receipt = receipt_in(result.receipt).model_copy(update={"scores": scores})
                    envelope = server.state.signer.sign(receipt)
                    row.store_result(name, BoardResult(report=report, receipt=envelope))

    def _ask(
        self, server: Serving, identifiers: Identifiers, who: str | None, *request: str, **more: Any
    ) -> httpx.Response:
        headers = {"Authorization": f"Bearer {server.tokens[who]}"} if who else {}
        headers |= more.pop("headers", {})
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(secrets, "token_hex", identifiers.token_hex)
            patched.setattr(secrets, "token_urlsafe", identifiers.token_urlsafe)
            reply = server.client.request(*request, headers=headers, **more)
        server.client.cookies.clear()
        return reply

    def _shown(self, reply: httpx.Response, which: int, has_scores: bool) -> tuple[Any, bytes]:  # noqa: FBT001
        """Return headers and body of a reply without what may differ."""
        headers = {
            name: value
            for name, value in reply.headers.items()
            if not (has_scores and name in _VARIABLE_HEADERS)
        }
        body = reply.content
        if reply.headers.get("content-type", "").startswith("text/plain; version"):
            headers.pop("content-length", None)
            body = _TIMINGS.sub(b"", body)
        if b'"payloadType":' in body:
            body = json.dumps(_opened(json.loads(body))).encode()
        if has_scores:
            body = json.dumps(_without_scores(json.loads(body))).encode()
        fingerprint = self.servers[which].state.boards[PRIVATE].truth.fingerprint
        body = body.replace(fingerprint.encode(), b"-" * len(fingerprint))
        body = body.replace(fingerprint[:_SHOWN].encode(), b"-" * _SHOWN)
        return headers, body


def _opened(document: Any) -> Any:
    """Return a document with what is signed in place of envelopes: signatures are those of all."""
    if isinstance(document, dict):
        if isinstance(document.get("payloadType"), str):
            return payload_in(document)
        return {key: _opened(value) for key, value in document.items()}
    return [_opened(each) for each in document] if isinstance(document, list) else document


def _without_scores(document: Any) -> Any:
    if isinstance(document, dict):
        return {
            key: (sorted(value) if isinstance(value, dict) else None)
            if key == _SCORED
            else _without_scores(value)
            for key, value in document.items()
        }
    if isinstance(document, list):
        return [_without_scores(each) for each in document]
    return document


def open_twins(open_server: OpenServer, folders: tuple[Path, Path], seed: int) -> Twins:
    """Open the servers of two copies of a folder, with another solution in the second."""
    path = Path("bundles") / f"{PRIVATE}.npz"
    bundle = Bundle.load(folders[0] / path)
    other = with_other_answers(bundle, seed)
    assert other.public().header == bundle.public().header
    other.save(folders[1] / path)
    servers = []
    for folder in folders:
        settings = settings_of(folder)
        quota = settings.splits[PRIVATE].effective_quota.model_copy(update=PLENTY)
        servers.append(open_server(adjusted(settings, quota=quota, boards=OTHER_BOARDS)))
    left, right = servers
    return Twins((left, right))
