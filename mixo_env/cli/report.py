"""`mixo report`: the page of a folder of results, written again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro


@dataclass(frozen=True)
class Report:
    """Write report.html anew from a folder of results, without computing anything.

    Worked examples:

      mixo report results/latest                        after failures.json was put beside leaderboard.json
    """

    interrupted: ClassVar[str] = "nothing was written"

    results: Annotated[Path, tyro.conf.Positional]
    """Folder that `mixo benchmark` wrote."""

    def run(self) -> int:
        """Check the results, write the page, print its path."""
        from mixo_env.leaderboard.report_page import write_report

        print(f"Read {write_report(self.results)}")
        return 0
