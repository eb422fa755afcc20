"""Words: what instructions are made of."""

import re
from collections.abc import Sequence

FREQUENT = 5
"""How often a word occurs at least to be frequent, in all that is described.

The dataset's own vocabulary for training is built so: ``build_vocab(min_count=5)`` in
``tasks/REVERIE/utilsFast.py`` of its repository.
"""

_WORD = re.compile(r"\w+")


def words_of(instruction: str) -> Sequence[str]:
    """Return the words of an instruction in their order, in lower case.

    A word is a run of letters, digits and underscores. Everything else, an apostrophe or a hyphen
    too, separates words and is none itself.

    References
    ----------
    .. [1] ``Tokenizer.split_sentence`` in ``tasks/REVERIE/utilsFast.py`` of the dataset's
       repository separates at the same places. It keeps punctuation as tokens of their own, which
       are no words.

    Examples
    --------
    >>> words_of("Go to level 2; don't touch the T-shirt")
    ['go', 'to', 'level', '2', 'don', 't', 'touch', 'the', 't', 'shirt']
    """
    return _WORD.findall(instruction.lower())
