"""Change single bytes of files of every form, and compare what the two readers make of them.

``python benchmarks/reader_edits.py [COUNT]`` changes each file so many times, by default 10,000: a
million and a half in all, which takes about an hour. The suite does the same with a few. It prints
how many changed files the fast reader took, and ends at the first that the readers do not agree on.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.support.both_readers import edited, read_by_both, small_files

COUNT = 10_000


def main() -> int:
    """Compare the readers."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else COUNT
    tried = taken = 0
    for name, (content, task) in small_files().items():
        for changed in edited(content, count, seed=f"{name}, {count}"):
            tried += 1
            taken += read_by_both(changed, task)
    print(f"{tried:,} changed files, {taken:,} of them read fast and alike")
    return 0


if __name__ == "__main__":
    sys.exit(main())
