"""Pieces of LaTeX: texts that come out as they are, rows of a table, comments."""

from collections.abc import Iterable, Sequence

_NAMED = {
    "~": "asciitilde",
    "^": "asciicircum",
    "\\": "backslash",
    "<": "less",
    ">": "greater",
    "|": "bar",
}
_SPECIAL = str.maketrans(
    {letter: f"\\{letter}" for letter in "&%$#_{}"}
    | {letter: f"{{{letter}}}" for letter in "[]*"}  # which say something after a row's end
    | {letter: rf"\text{name}{{}}" for letter, name in _NAMED.items()}
    | dict.fromkeys("\n\r", " ")  # of which two would end a paragraph
)
"""What means something else in LaTeX, or is another letter in its first font encoding."""


def escaped(text: str) -> str:
    r"""Write a text so that LaTeX shows it as it is.

    Letters beyond the Latin ones are left as they are: they need xelatex or lualatex, and a font
    that has them. Quotation marks, and hyphens in a row, come out as LaTeX sets them.

    >>> print(escaped("DUET_{ours} & 100% ~ a|b"))
    DUET\_\{ours\} \& 100\% \textasciitilde{} a\textbar{}b
    """
    return text.translate(_SPECIAL)


def table_row(cells: Iterable[str]) -> str:
    r"""Return a row of a table, of cells that are LaTeX already.

    >>> print(table_row(["Ours", r"\textbf{57.22}"]))
    Ours & \textbf{57.22} \\
    """
    return " & ".join(cells) + r" \\"


def comments(lines: Iterable[str]) -> Sequence[str]:
    r"""Write lines for whoever reads the source; LaTeX shows nothing of them.

    >>> comments(["95 % intervals", "", "of a\nb.npz"])
    ['% 95 % intervals', '%', '% of a b.npz']
    """
    return [f"% {' '.join(line.splitlines())}".rstrip() for line in lines]
