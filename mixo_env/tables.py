"""Tables of results in the forms people paste: plain text, CSV, Markdown, LaTeX."""

from __future__ import annotations

import csv
import io
import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from mixo_env.errors import printable

Cell = str | int | float | None

_LEAST_NAME = 8
"""Characters left to the names of rows, however narrow the terminal."""
_FORMULA = tuple("=+-@＝＋－＠")


def csv_cell(cell: Cell) -> Cell:
    """A cell as every CSV file of ours holds it: a missing value is empty, text is no formula.

    Spreadsheets run text that begins with ``=``, ``+``, ``-`` or ``@``: names from data get an apostrophe before it.
    """
    if isinstance(cell, str):
        cell = printable(cell)
        return f"'{cell}" if cell.lstrip()[:1] in _FORMULA else cell
    return "" if cell is None or (isinstance(cell, float) and math.isnan(cell)) else cell


@dataclass(frozen=True)
class Column:
    """A heading, its unit, and how numbers are printed (CSV keeps all digits)."""

    heading: str
    unit: str = ""
    spec: str = ""

    def text(self, cell: Cell) -> str:
        """The cell as printed; a missing value is a dash."""
        if cell is None or (isinstance(cell, float) and math.isnan(cell)):
            return "-"
        return printable(cell) if isinstance(cell, str) else format(cell, self.spec)

    @property
    def title(self) -> str:
        """Heading with its unit in brackets."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading


@dataclass(frozen=True)
class Table:
    """A caption that states the convention, columns, and rows of cells.

    Attributes:
        caption, columns, rows: what every form prints.
        begins: numbers of the rows that begin a group; plain text leaves a line free before them.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: Sequence[Sequence[Cell]]
    begins: Sequence[int] = ()

    def text(self, width: int = 0) -> str:
        """Aligned plain text; the first column is a name, the others are numbers.

        Args:
            width: characters of the terminal, to which long names are wrapped; 0: as wide as it gets.
        """
        lines = [[column.title for column in self.columns], *self._printed()]
        widths = [max(len(line[k]) for line in lines) for k in range(len(self.columns))]
        if width:
            widths[0] = min(widths[0], max(width - sum(widths[1:]) - 2 * (len(widths) - 1), _LEAST_NAME))
        heading, *aligned = (_aligned(line, widths) for line in lines)
        for row in sorted(self.begins, reverse=True):
            aligned.insert(row, "")
        return "\n".join([textwrap.fill(self.caption, width or 100), heading, "-" * len(heading), *aligned]) + "\n"

    def csv(self) -> str:
        """Comma-separated values with all digits, without the caption; a missing value is empty."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([column.title for column in self.columns])
        for row in self.rows:
            writer.writerow([csv_cell(cell) for cell in row])
        return out.getvalue()

    def markdown(self) -> str:
        """A GitHub table under its caption."""
        heading = "| " + " | ".join(_escape_markdown(column.title) for column in self.columns) + " |"
        rule = "|" + "|".join("---" if k == 0 else "---:" for k in range(len(self.columns))) + "|"
        rows = ["| " + " | ".join(map(_escape_markdown, row)) + " |" for row in self._printed()]
        return "\n".join([self.caption, "", heading, rule, *rows]) + "\n"

    def latex(self) -> str:
        r"""A ``table`` environment; needs the package ``booktabs``."""
        heading = " & ".join(_escape_latex(column.title) for column in self.columns)
        rows = [" & ".join(map(_escape_latex, row)) + r" \\" for row in self._printed()]
        return (
            "\n".join(
                [
                    r"\begin{table}",
                    r"  \centering",
                    rf"  \caption{{{_escape_latex(self.caption)}}}",
                    rf"  \begin{{tabular}}{{l{'r' * (len(self.columns) - 1)}}}",
                    r"    \toprule",
                    rf"    {heading} \\",
                    r"    \midrule",
                    *(f"    {row}" for row in rows),
                    r"    \bottomrule",
                    r"  \end{tabular}",
                    r"\end{table}",
                ]
            )
            + "\n"
        )

    def _printed(self) -> list[list[str]]:
        return [[column.text(cell) for column, cell in zip(self.columns, row, strict=True)] for row in self.rows]


def _aligned(cells: Sequence[str], widths: Sequence[int]) -> str:
    """One row: the name to the left, on as many lines as it takes, the others to the right of the first of them."""
    first, *more = textwrap.wrap(cells[0], widths[0]) or [""]
    numbers = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
    return "\n".join(["  ".join([first.ljust(widths[0]), *numbers]).rstrip(), *more])


def _escape_markdown(text: str) -> str:
    return text.replace("|", r"\|")


def _escape_latex(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    special |= {character: f"\\{character}" for character in "&%$#_{}"}
    return "".join(special.get(character, character) for character in text)
