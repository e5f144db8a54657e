"""Compact letter display: rows that cannot be told apart share a letter.

Insert and absorb after Piepho (2004): start with one column that holds every row; every pair that differs splits each
column that holds both into two, one without either; a column that another one contains says nothing and goes.
"""

from __future__ import annotations

import string
from collections.abc import Collection, Sequence

ALPHABET = string.ascii_lowercase + string.ascii_uppercase


def letters(rows: Sequence[str], differ: Collection[tuple[str, str]]) -> dict[str, str]:
    """Letters of every row.

    Args:
        rows: best first: its letter is ``a``.
        differ: pairs, in either order, that can be told apart.

    Returns:
        Row -> its letters in alphabetical order. Two rows share one exactly if they are no pair of ``differ``.
    """
    columns = [frozenset(rows)]
    for first, second in sorted(differ):
        split = [column for column in columns if {first, second} <= column]
        kept = [column for column in columns if column not in split]
        for column in split:
            for part in (column - {first}, column - {second}):
                if not any(part <= other for other in kept):
                    kept = [*(other for other in kept if not other <= part), part]
        columns = kept
    columns.sort(key=lambda column: sorted(rows.index(row) for row in column))
    return {row: "".join(_letter(k) for k, column in enumerate(columns) if row in column) for row in rows}


def _letter(index: int) -> str:
    """Lower case, then upper case, then a2 ..."""
    turn, place = divmod(index, len(ALPHABET))
    return ALPHABET[place] + (str(turn + 1) if turn else "")
