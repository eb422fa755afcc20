"""Whether the time of a reply tells right answers from wrong ones, on the published REVERIE files.

``python benchmarks/reply_times.py`` starts a real server with val_unseen as a private split whose
scores are held back until the phase ends, so that a reply says nothing of them. It sends pairs of
files that differ in their answers alone: in one all answers are right, in the other all are wrong,
with as many digits. Each pair is checked, and submitted, in random order. If times tell nothing,
the right file is the slower one in half of the pairs; the sign test says how surprising the count
is, and the interval of the median how large a difference could have been missed. The bar is
p >= 0.001. In a third comparison one file is twice as long, by spaces, which has to be found.
Needs the published files (see ``fixtures/published.py``).
"""

import http.client
import json
import math
import statistics
import sys
import time
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import NamedTuple, Self
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.server import SERVER, SPLIT, make_server, running, variants
from fixtures.published import published_folder, unpack_dataset
from reverie_eval import GroundTruth
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.runner import run_agent

PAIRS = 500
WARM_UP = 20
BAR = 0.001
CHECK = f"/api/v1/splits/{SPLIT}/validate"
SUBMIT = f"/api/v1/splits/{SPLIT}/submissions?name=walker"
HELD_BACK = """
phases = [{ name = "challenge", closes = 2100-01-01T00:00:00Z }]
release_scores = "phase-end"
"""


class Compared(NamedTuple):
    """In how many pairs the first file took longer, and by how many milliseconds in the median."""

    slower: int
    pairs: int
    low: float
    median: float
    high: float

    @classmethod
    def of(cls, differences: Sequence[float]) -> Self:
        """Compare pairs by their differences in seconds; low and high are a 95 % interval."""
        ordered, n = sorted(1000 * each for each in differences), len(differences)
        margin = math.ceil(0.98 * math.sqrt(n))
        ends = ordered[n // 2 - margin], ordered[n // 2 + margin]
        return cls(
            sum(each > 0 for each in ordered), n, ends[0], statistics.median(ordered), ends[1]
        )

    @property
    def p(self) -> float:
        """Two-sided p of the sign test: so uneven a count, if both are equally likely slower."""
        most = max(self.slower, self.pairs - self.slower)
        tail = sum(math.comb(self.pairs, k) for k in range(most, self.pairs + 1))
        return min(1.0, tail / (1 << (self.pairs - 1)))


def main() -> int:
    """Print every figure; exit with 1 if one misses its bar."""
    folder = published_folder()
    if folder is None:
        print("the published REVERIE files are not here (REVERIE_DATA names their folder)")
        return 2
    with TemporaryDirectory() as temporary:
        work = Path(temporary)
        files = DatasetFiles.find(unpack_dataset(folder, work), split=SPLIT)
        server = work / "server"
        server.mkdir()
        compile_split(files, SPLIT).save(server / f"{SPLIT}.npz")
        token, *_ = make_server(server, "private")
        hold_scores_back(server / "reverie-eval.toml")
        right, wrong = answered(GroundTruth.load(server / f"{SPLIT}.npz"))
        with running(SERVER, server, 1) as (url, _):
            client = Client(url, token)
            checked = client.compare(CHECK, 200, right, wrong)
            submitted = client.compare(SUBMIT, 201, right, wrong)
            longer = client.compare(CHECK, 200, right + b" " * len(right), right)
    return int(
        tell("checked: right answers slower than wrong ones", checked, differs=False)
        + tell("submitted: right answers slower than wrong ones", submitted, differs=False)
        + tell("checked: twice as long slower", longer, differs=True)
        > 0
    )


def tell(what: str, compared: Compared, *, differs: bool) -> bool:
    """Print a comparison; return whether it came out otherwise than it should."""
    is_missed = (compared.p < BAR) is not differs
    print(
        f"{what} in {compared.slower} of {compared.pairs} pairs, by {compared.median:.2f} ms in "
        f"the median (95 % between {compared.low:.2f} and {compared.high:.2f}); "
        f"p = {compared.p:.2g}   {'below' if differs else 'at least'} {BAR}   "
        f"{'MISSED' if is_missed else 'ok'}"
    )
    return is_missed


def hold_scores_back(settings: Path) -> None:
    """Change the settings: scores are not released before the phase ends, and files may be many."""
    rules, limits, numbers = settings.read_text().partition("\n[limits]\n")
    settings.write_text(f"{rules}{HELD_BACK}{limits}mebibytes_per_day = 1000000\n{numbers}")


def answered(truth: GroundTruth) -> tuple[bytes, bytes]:
    """Return two files whose agents walk to their goals: with all answers right, and all wrong.

    A wrong answer is the right one with another last digit.
    """
    records = run_agent("shortest", truth)
    targets = truth.require_solution().target_object.tolist()
    others = [target + (1 if target % 10 < 9 else -1) for target in targets]
    right, wrong = (
        [{**record, "predObjId": answer} for record, answer in zip(records, answers, strict=True)]
        for answers in (targets, others)
    )
    return json.dumps(right).encode(), json.dumps(wrong).encode()


class Client:
    """Sends files over one connection, and takes the time of each."""

    def __init__(self, url: str, token: str) -> None:
        self._connection = http.client.HTTPConnection(urlsplit(url).netloc)
        self._headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}
        self._random = Random(1)  # noqa: S311  # no secret

    def compare(self, path: str, status: int, first: bytes, second: bytes) -> Compared:
        """Send pairs of files, each in random order and unlike all others in one digit."""
        differences = []
        for pair in islice(zip(variants(first), variants(second), strict=False), PAIRS + WARM_UP):
            order = self._random.sample((0, 1), 2)
            took = {which: self._send(path, status, pair[which]) for which in order}
            differences.append(took[0] - took[1])
        return Compared.of(differences[WARM_UP:])

    def _send(self, path: str, status: int, body: bytes) -> float:
        start = time.perf_counter()
        self._connection.request("POST", path, body, self._headers)
        reply = self._connection.getresponse()
        content = reply.read()
        seconds = time.perf_counter() - start
        if reply.status != status:
            raise RuntimeError(f"status {reply.status} instead of {status}: {content[:200]!r}")
        return seconds


if __name__ == "__main__":
    sys.exit(main())
