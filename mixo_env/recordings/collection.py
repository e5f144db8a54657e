"""Recorded scenes in memory: flat columns, one offset per scene, and selections that share them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, RecordingError, unknown
from mixo_env.experts.families import FAMILIES, is_family_expert
from mixo_env.recordings.schema import HEADLINE_TRACKS, SPLITS, TRACKS, UNEQUAL, Manifest, SceneEntry, in_split

Column = NDArray[Any]


class Recordings:
    """Scenes of one recording.

    Attributes:
        manifest: describes exactly the scenes held here.
        offsets: ``(scenes + 1,)``; rows ``offsets[i]:offsets[i + 1]`` of every column belong to scene i.
    """

    def __init__(self, manifest: Manifest, columns: Mapping[str, Column]) -> None:
        """Hold ``columns`` (all of the same length, scenes one after another in the manifest's order)."""
        self.manifest = manifest
        self._columns = dict(columns)
        self.offsets = np.concatenate([[0], np.cumsum([scene.rows for scene in manifest.scenes], dtype=np.int64)])
        for name, values in self._columns.items():
            if len(values) != self.offsets[-1]:
                raise RecordingError(
                    f"column {name!r} has {len(values)} rows, but the manifest counts {self.offsets[-1]}: record anew"
                )

    def __len__(self) -> int:
        """Number of scenes."""
        return len(self.manifest.scenes)

    def __getitem__(self, column: str) -> Column:
        """One column over all scenes, ``(rows,)``; an unknown name raises :class:`RecordingError`."""
        try:
            return self._columns[column]
        except KeyError:
            raise RecordingError(unknown("column", column, self._columns)) from None

    def __contains__(self, column: str) -> bool:
        return column in self._columns

    @property
    def scenes(self) -> tuple[SceneEntry, ...]:
        """The scenes held, in order."""
        return self.manifest.scenes

    @property
    def experts(self) -> tuple[str, ...]:
        """Every expert that votes in some track: cameras, inertial, imported, then recorded ones of other families."""
        recorded = tuple(name for name in self.further if name not in self.manifest.imported)
        return self.manifest.cameras + self.manifest.inertial + self.manifest.imported + recorded

    @property
    def further(self) -> tuple[str, ...]:
        """Experts of other families, recorded or imported: they vote in UNEQUAL and in no other track.

        Without any camera there is no headline to keep them out of: imported experts are all alike then.
        """
        names = (*self.manifest.variants, *self.manifest.imported) if self.manifest.cameras else ()
        return tuple(name for name in names if is_family_expert(name))

    @property
    def headline_imported(self) -> tuple[str, ...]:
        """Imported experts that vote in every track: those of no family."""
        return tuple(name for name in self.manifest.imported if name not in self.further)

    @property
    def column_names(self) -> tuple[str, ...]:
        """All columns in file order."""
        return tuple(self._columns)

    @cached_property
    def fingerprint(self) -> bytes:
        """Hash of every column, to the last bit."""
        digest = hashlib.blake2b(digest_size=16)
        for name in sorted(self._columns):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(self._columns[name]).tobytes())
        return digest.digest()

    @property
    def counting(self) -> tuple[str, ...]:
        """Experts whose match counts are observed: cameras, and imported ones if any of those brought counts.

        Further experts count among themselves, so that they change nothing that the others observe.
        """
        counted = self.manifest.counted
        imported = self.headline_imported if any(name in counted for name in self.headline_imported) else ()
        further = tuple(name for name in self.further if name in counted or name in self.manifest.variants)
        return self.manifest.cameras + imported + further

    @property
    def tracks(self) -> tuple[str, ...]:
        """Tracks that can be played here: those whose inertial expert is recorded, or all if no inertial one is.

        VISION needs somebody besides the inertial experts, UNEQUAL an expert of another family.
        """
        inertial, others = self.manifest.inertial, self.manifest.cameras + self.manifest.imported
        playable = [t for t in HEADLINE_TRACKS if TRACKS[t] in inertial or (others and not (inertial and TRACKS[t]))]
        return (*playable, *([UNEQUAL] if self.further else []))

    @property
    def distinct_tracks(self) -> tuple[str, ...]:
        """The tracks that differ: without any inertial expert all but UNEQUAL are VISION."""
        return self.tracks if self.manifest.inertial else tuple(t for t in self.tracks if t in ("VISION", UNEQUAL))

    def voters(self, track: str) -> tuple[str, ...]:
        """Experts that vote in ``track``: cameras, imported ones, then the track's inertial expert.

        In UNEQUAL the experts of other families follow instead, and in no other track: recording them changes nothing
        there. Where no inertial expert is recorded at all, the other tracks all have the voters of VISION.

        Raises:
            ConfigurationError: for an unknown track, or one whose own experts are missing.
        """
        if track not in TRACKS:
            raise ConfigurationError(unknown("track", track, TRACKS))
        if track not in self.tracks:
            needed = TRACKS[track] or "a camera or an imported expert"
            if track == UNEQUAL:
                families = ", ".join(f"{family}_..." for family in FAMILIES)
                needed = f"an expert of another family beside the cameras ({families}; mixo record --experts TUTORIAL)"
            raise ConfigurationError(
                f"track {track} needs {needed}, which these recordings lack: "
                f"choose {', '.join(self.tracks) or 'others'}"
            )
        voter = TRACKS[track]
        inertial = (voter,) if voter in self.manifest.inertial else ()
        return self.manifest.cameras + self.headline_imported + (self.further if track == UNEQUAL else inertial)

    def index(self, scene: str) -> int:
        """Position of a scene by name."""
        names = [entry.name for entry in self.scenes]
        if scene not in names:
            raise ConfigurationError(unknown("scene", scene, names))
        return names.index(scene)

    def rows(self, scene: str | int) -> dict[str, Column]:
        """All columns of one scene (views)."""
        i = self.index(scene) if isinstance(scene, str) else scene
        return {name: values[self.offsets[i] : self.offsets[i + 1]] for name, values in self._columns.items()}

    def replace(self, manifest: Manifest | None = None, columns: Mapping[str, Column] | None = None) -> Recordings:
        """The same scenes with another manifest, or with columns added or exchanged; the rest is shared."""
        return Recordings(manifest or self.manifest, self._columns | dict(columns or {}))

    def select(
        self,
        *,
        split: str | None = None,
        folds: Sequence[int] | None = None,
        conditions: Iterable[str] | None = None,
        scenes: Sequence[str] | None = None,
    ) -> Recordings:
        """The scenes that meet every given criterion, in order.

        Args:
            split: a name in ``SPLITS``.
            folds: folds to keep (-1: the out-of-distribution scenes).
            conditions: keep scenes that show *all* of these, e.g. ``["rain"]``.
            scenes: names to keep; an unknown one is an error.

        Raises:
            ConfigurationError: for unknown names, or when nothing is left.
        """
        if split is not None and split not in SPLITS:
            raise ConfigurationError(unknown("split", split, SPLITS))
        if scenes is not None:
            for name in scenes:
                self.index(name)
        wanted = set(conditions or ())
        shown = {condition for entry in self.scenes for condition in entry.conditions}
        for condition in sorted(wanted - shown):
            raise ConfigurationError(unknown("condition", condition, shown))
        keep = [
            i
            for i, entry in enumerate(self.scenes)
            if (split is None or in_split(entry.fold, split))
            and (folds is None or entry.fold in folds)
            and (scenes is None or entry.name in scenes)
            and wanted <= set(entry.conditions)
        ]
        if not keep:
            raise ConfigurationError(
                f"no scene left: expected at least one with split={split!r}, folds={folds!r}, "
                f"conditions={sorted(wanted)!r} among {len(self)} scenes; widen the choice"
            )
        if len(keep) == len(self):
            return self
        rows = np.concatenate([np.arange(self.offsets[i], self.offsets[i + 1]) for i in keep])
        manifest = replace(self.manifest, scenes=tuple(self.scenes[i] for i in keep))
        return Recordings(manifest, {name: values[rows] for name, values in self._columns.items()})
