"""The report: one HTML page that needs no network, written from a folder of results."""

from __future__ import annotations

import gzip
import html
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from mixo_env.files import write_text
from mixo_env.leaderboard.answers import answers, command
from mixo_env.leaderboard.results import Results, read_results
from mixo_env.leaderboard.sentences import left_out_lines

PAGE = "report.html"
PARTS = ("table.js", "charts.js", "drives.js")

Values = Mapping[str, Any]


def write_report(folder: Path) -> Path:
    """Write the page of a folder of results into it.

    Returns:
        Its path.

    Raises:
        ResultsError: when the folder does not hold whole results.
        OutputError: when the page cannot be written.
    """
    path = folder / PAGE
    write_text(path, page(read_results(folder)))
    return path


def page(results: Results) -> str:
    """The whole page: text, style, data, plotting library and scripts in one file."""
    source = files("mixo_env.leaderboard") / "page"
    library = gzip.decompress((source / "plotly-basic.min.js.gz").read_bytes()).decode()
    scripts = [library, *((source / name).read_text(encoding="utf-8") for name in PARTS)]
    filled = {
        "title": html.escape(f"MixoOdometry report: {results.leaderboard['data_version']}"),
        "style": (source / "report.css").read_text(encoding="utf-8"),
        "answers": _answers(results),
        "data": embedded(_data(results)),
        "scripts": "\n".join(f"<script>\n{script}\n</script>" for script in scripts),
    }
    text = (source / "report.html").read_text(encoding="utf-8")
    # Cut once, so that nothing in the data is taken for a place to fill.
    pieces = re.split(r"@(\w+)@", text)
    return "".join(filled[piece] if i % 2 else piece for i, piece in enumerate(pieces))


def embedded(value: Any) -> str:
    """Plain values as JSON that cannot end the script it stands in, whatever its strings hold."""
    import msgspec

    text = msgspec.json.encode(value).decode()
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _answers(results: Results) -> str:
    found = answers(results.leaderboard, results.configuration)
    lines = []
    for question, answer in found:
        told = html.escape(answer)
        lines.append(f"<dt>{html.escape(question)}</dt>")
        lines.append(
            f"<dd><code>{told}</code></dd>" if answer == command(results.configuration) else f"<dd>{told}</dd>"
        )
    return "\n".join(lines)


def _data(results: Results) -> dict[str, Any]:
    board, configuration = results.leaderboard, results.configuration
    night = board["night"]
    return {
        "tracks": {
            name: {
                "groups": [
                    {"by": "all", "name": "every scene in a fold", "rows": _rows(table["rows"])},
                    *({**_named(group), "rows": _rows(group["rows"])} for group in table["groups"]),
                    *(
                        [{"by": "condition", "name": "night, in no fold", "rows": _rows(night["tracks"][name]["rows"])}]
                        if night and name in night["tracks"]
                        else []
                    ),
                    *(
                        [
                            {
                                "by": "fold",
                                "name": f"{table['one_fold']} alone, learned policies",
                                "rows": _rows(table["one_fold_rows"]),
                            }
                        ]
                        if table["one_fold_rows"]
                        else []
                    ),
                ],
                "left_out": left_out_lines(table["left_out"]),
            }
            for name, table in board["tracks"].items()
        },
        "conventions": board["conventions"],
        "outlier_sigmas": board["outlier_sigmas"],
        "software": configuration["software"],
        "hashes": configuration["scenes"],
        "drives": results.drives,
        "failures": results.failures,
    }


def _named(group: Values) -> dict[str, Any]:
    return {"by": group["by"], "name": group["name"].replace("_", " ")}


def _rows(rows: Sequence[Values]) -> list[dict[str, Any]]:
    """What the page shows of every row: its headline score, the rest as it stands in the results."""
    shown = []
    for row in rows:
        score = next(iter(row["scores"].values()))
        shown.append(
            {name: row[name] for name in ("policy", "privileged", "reference", "letters")}
            | {"differences": {name: found and _short(found) for name, found in row["differences"].items()}}
            | {
                name: row[name]
                for name in ("lost_per_scene", "interquartile_mean_deg_per_m", "probability_of_improvement")
            }
            | {name: row[name] for name in ("lengths", "anatomy")}
            | score
        )
    return shown


def _short(difference: Values) -> dict[str, Any]:
    return {name: difference[name] for name in ("share", "p_holm")}
