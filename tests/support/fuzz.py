"""Search for files that a reader fails at, guided by the lines that they reach.

``python -m tests.support.fuzz submissions -max_total_time=300`` starts from small files and stops
at the first that raises anything but a refusal, takes longer than 10 seconds or more than 1 GiB.
The remaining arguments are libFuzzer's. The file is left in the current folder.
"""

import sys
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

LIMITS = ("-timeout=10", "-rss_limit_mb=1024", "-max_len=20000", "-print_final_stats=1")
FROM_EXAMPLES = ("-keep_seed=1", "-len_control=0")
"""All examples are kept, though each file of a sound dataset reaches the same lines."""
TOKENS = (
    *('"instr_id"', '"trajectory"', '"predObjId"', '"predBox"', '"predView"', '"predImageSize"'),
    *('"pred_objid"', '"visible_pos"', '"bbox2d"', '"unobstructed"', '"pose"', '"included"'),
    *("null", "true", "NaN", "Infinity", "-1", "1e999"),
    *("\\x1f\\x8b", "PK\\x03\\x04", "[", "{", "},"),
)


def main(name: str, *options: str) -> None:
    """Fuzz a reader until libFuzzer stops."""
    import atheris

    with atheris.instrument_imports(include=["reverie_eval", "json"]):
        from tests.support.mutated_files import damaged
        from tests.support.readers import READERS

    def mutate(content: bytes, most: int, seed: int) -> bytes:
        """Change values of a document as people would, or bytes as libFuzzer does."""
        random, head = Random(seed), READERS[name].head
        if random.random() < 0.5:
            return bytes(atheris.Mutate(content, most))
        return (content[:head] + damaged(random, content[head:]))[:most]

    reader = READERS[name]
    with TemporaryDirectory() as temporary:
        corpus, tokens = Path(temporary, "corpus"), Path(temporary, "tokens")
        corpus.mkdir()
        for number, content in enumerate(reader.examples()):
            (corpus / f"{number}").write_bytes(content)
        quoted = (token.replace('"', '\\"') for token in TOKENS)
        tokens.write_text("".join(f'"{token}"\n' for token in quoted), encoding="latin-1")
        words = [sys.argv[0], *LIMITS, *FROM_EXAMPLES, f"-dict={tokens}", *options, str(corpus)]
        atheris.Setup(words, reader.accepts, custom_mutator=mutate)
        atheris.Fuzz()


if __name__ == "__main__":
    main(*sys.argv[1:])
