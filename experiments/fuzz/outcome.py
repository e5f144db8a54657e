"""What came of damaged inputs: counts, and every fault."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

FAULTS_SHOWN = 10


@dataclass
class Outcome:
    """Counts of a run, and what must not happen: what was tried and the traceback of every fault."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[tuple[str, str]] = field(default_factory=list)

    def report(self, inputs: int) -> int:
        """Print the counts and one fault of a kind; exit code 1 if there is one."""
        print(f"{inputs} inputs: {dict(self.counts)}, {len(self.faults)} faults")
        kinds = {text.strip().rsplit("\n", 1)[-1]: (what, text) for what, text in reversed(self.faults)}
        for what, text in list(kinds.values())[:FAULTS_SHOWN]:
            print(what, text, sep="\n")
        return int(bool(self.faults))
