"""Write docs/mixocity.md and its pictures.

python -m docs._pages.data_sheet --images FOLDER --recordings NAME_OR_PATH --out docs
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from mixo_env.errors import MixoError

PAGE, MEASURED, STUDY = "mixocity.md", "mixocity.json", "situation-shares.json"


@dataclass(frozen=True)
class DataSheet:
    """Write the data sheet of a simulated data set.

    Worked examples:

      python -m docs._pages.data_sheet --images city                the bundled recordings and their images
      python -m docs._pages.data_sheet                              the page anew from what was measured before
    """

    images: Path | None = None
    """Folder written by `mixo simulate`. None: what was measured there before (mixocity.json beside the page)."""
    recordings: str | None = None
    """Folder written by `mixo record` from these images, or the name of a bundled recording. None: mixocity."""
    out: Path = Path("docs")
    """Folder of the page; the pictures go to figures/mixocity below it."""
    strip: bool = True
    """Render all six cameras for the first picture."""

    def run(self) -> int:
        """Measure what there is, and write."""
        from docs._pages.data_sheet import real
        from docs._pages.data_sheet.folder import open_city
        from docs._pages.data_sheet.measured import measure
        from docs._pages.data_sheet.motion import recorded_paths
        from docs._pages.data_sheet.page import FIGURES, page
        from docs._pages.data_sheet.samples import draw_motion
        from experiments import stored_figures as stored
        from mixo_env.files import write_text
        from mixo_env.recordings.store import load_recordings

        recordings = load_recordings(self.recordings)
        self.out.mkdir(parents=True, exist_ok=True)
        if self.images is not None:
            real.refresh()
            city = open_city(self.images)
            stored.save(self.out / MEASURED, measure(city, self.out / FIGURES, self.strip, told=print))
        measured, known = stored.load(self.out / MEASURED), real.load_real()
        study = stored.load(self.out / STUDY) if (self.out / STUDY).exists() else None
        text = page(recordings, measured, known, study)
        draw_motion(recorded_paths(recordings), known["motion"], self.out / FIGURES / "motion.png")
        write_text(self.out / PAGE, text)
        print(f"wrote {self.out / PAGE}")
        return 0


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(DataSheet, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"data_sheet: {error}")
