"""The page in one piece: text, style, numbers and scripts of this folder, and nothing from anywhere else."""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from mixo_env.leaderboard.report_page import embedded

SCRIPTS = ("odometry.js", "charts.js", "play.js")
HERE = Path(__file__).parent


def page(drive: dict[str, Any]) -> str:
    """The page of one drive with its pictures."""
    filled = {
        "title": html.escape(f"Play a drive: {drive['scene']} of {drive['data']}"),
        "style": (HERE / "play.css").read_text(encoding="utf-8"),
        "drive": embedded(drive),
        "scripts": "\n".join(f"<script>\n{(HERE / name).read_text(encoding='utf-8')}</script>" for name in SCRIPTS),
    }
    # Cut once, so that nothing in the data is taken for a place to fill.
    pieces = re.split(r"@(\w+)@", (HERE / "play.html").read_text(encoding="utf-8"))
    return "".join(filled[piece] if i % 2 else piece for i, piece in enumerate(pieces))
