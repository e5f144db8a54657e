"""What a grid search found: its table, its sentences, and the picture of the landscape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.files import atomic_path
from mixo_env.policies.gates import FloatArray, Setting
from mixo_env.policies.search import PAPER, Final, Judged
from mixo_env.tables import Column, Table

SYMBOLS = ("N1", "N2", "d1", "d2", "eta0", "alpha")

LEGEND_SHARE = 0.35
"""Of an axis, kept free above the data for the legend."""


@dataclass(frozen=True)
class Landscape:
    """A finished search.

    Attributes:
        judged: the grid.
        final: its finalists.
        linear: LINEAR's error on each fold [deg/s].
        about: which data, for captions.
    """

    judged: Judged
    final: Final
    linear: Sequence[float]
    about: str

    def table(self) -> Table:
        """Finalists, best first, then the paper's optimum and LINEAR."""
        final, place = self.final, {setting: i for i, setting in enumerate(self.judged.settings)}
        mean = final.errors.mean(axis=(0, 1))
        spread = (final.errors - final.errors[..., [final.best]]).reshape(-1, len(mean)).std(axis=0)
        rows: list[list[Any]] = [
            [
                f"{rank + 1}{' =' if i in final.alike else ''}{' smallest' if i == final.smallest else ''}",
                *final.settings[i],
                float(self.judged.stages[-1, place[final.settings[i]]]),
                float(mean[i]),
                float(spread[i] / np.sqrt(final.errors[..., 0].size)),
            ]
            for rank, i in enumerate(np.argsort(mean, kind="stable").tolist())
        ]
        if PAPER in place:
            rows.append([f"paper ({self.paper_rank()})", *PAPER, self._reached(place[PAPER]), None, None])
        rows.append(["LINEAR", *[None] * 6, float(np.mean(self.linear)), None, None])
        columns = (
            Column("rank"),
            *(Column(symbol, spec="g") for symbol in SYMBOLS),
            Column("grid", "deg/s", ".5f"),
            Column("again", "deg/s", ".5f"),
            Column("± to best", "deg/s", ".5f"),
        )
        seeds, folds = final.errors.shape[:2]
        caption = (
            f"Error of the yaw rate on held-out folds, mean over {folds} folds; {self.about}. grid: the training that "
            f"chose; again: mean of {seeds} more seeds; =: within one standard error of the best, paired by seed and "
            "fold; smallest: of those the smallest network."
        )
        return Table(caption, columns, rows, begins=(len(final.settings),))

    def paper_rank(self) -> str:
        """Where the paper's optimum stands in the grid, in words."""
        place = self.judged.settings.index(PAPER)
        column = self.judged.stages[:, place]
        stage = int(np.flatnonzero(~np.isnan(column))[-1])
        errors = self.judged.stages[stage]
        rank = 1 + int(np.sum(errors < column[stage]))
        reached = int(np.sum(~np.isnan(errors)))
        last = "" if stage == len(self.judged.stages) - 1 else f", left out after stage {stage + 1}"
        return f"{rank} of {reached}{last}"

    def sentences(self) -> list[str]:
        """What it comes to."""
        chosen, errors = self.final.nested
        mean, best = self.final.errors.mean(axis=(0, 1)), self.final.best
        names = ", ".join(_written(self.final.settings[i]) for i in sorted(set(chosen.tolist())))
        return [
            f"{len(self.final.alike)} of {len(mean)} finalists cannot be told from the best; the smallest of them is "
            f"{_written(self.final.settings[self.final.smallest])}.",
            f"Chosen without the fold that judges ({names}): {errors.mean():.5f} deg/s, where choosing on the folds "
            f"that are reported gives {mean[best]:.5f} and LINEAR {np.mean(self.linear):.5f}.",
        ]

    def to_json(self) -> dict[str, Any]:
        """Every number."""
        chosen, nested = self.final.nested
        return {
            "about": self.about,
            "symbols": list(SYMBOLS),
            "cost": self.judged.cost,
            "linear": list(self.linear),
            "finalists": [list(setting) for setting in self.final.settings],
            "again": self.final.errors.tolist(),
            "alike": list(self.final.alike),
            "smallest": self.final.smallest,
            "nested": {"chosen": chosen.tolist(), "errors": nested.tolist()},
            "settings": [list(setting) for setting in self.judged.settings],
            "stages": self.judged.stages.tolist(),
        }

    def draw(self, path: Path) -> None:
        """The best error that every pair of values allows, at the last stage that half of the grid has seen."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        stage = int(np.flatnonzero((~np.isnan(self.judged.stages)).mean(axis=1) >= 0.5)[-1])
        errors, table = self.judged.stages[stage], np.array(self.judged.settings, dtype=np.float64)
        figure = Figure(figsize=(10.5, 6.4), layout="constrained")
        FigureCanvasAgg(figure)
        axes: Any = figure.subplots(2, 3)
        for axis, (first, second) in zip(axes[0], ((0, 1), (2, 3), (4, 5)), strict=True):
            _draw_pair(axis, table[:, first], table[:, second], errors, (first, second))
        for axis, column in zip(axes[1], (0, 2, 4), strict=True):
            _draw_spread(axis, table[:, [column, column + 1]], errors, column, float(np.mean(self.linear)))
        figure.suptitle(f"Error of the yaw rate [deg/s] after stage {stage + 1}; {self.about}", fontsize=9)
        with atomic_path(path) as temporary:
            figure.savefig(temporary, format="png", dpi=110)

    def _reached(self, place: int) -> float | None:
        last = self.judged.stages[-1, place]
        return None if np.isnan(last) else float(last)


def _written(setting: Setting) -> str:
    return " ".join(f"{symbol} {value:g}" for symbol, value in zip(SYMBOLS, setting, strict=True))


def _draw_pair(axis: Any, x: FloatArray, y: FloatArray, errors: FloatArray, columns: tuple[int, int]) -> None:
    """Best error per pair of values, written into its square; the paper's choice is framed."""
    xs, ys = np.unique(x), np.unique(y)
    reached = np.where(np.isnan(errors), np.inf, errors)
    best = np.array([[reached[(x == a) & (y == b)].min() for a in xs] for b in ys])
    best[np.isinf(best)] = np.nan  # nobody got so far
    axis.imshow(best, origin="lower", cmap="cividis_r", aspect="auto")
    middle = 0.5 * (np.nanmin(best) + np.nanmax(best))
    for row, column in np.ndindex(best.shape):
        dark = best[row, column] < middle
        axis.text(
            column, row, f"{best[row, column]:.4f}", ha="center", va="center", fontsize=7,
            color="black" if not dark else "white",
        )  # fmt: skip
    axis.set_xticks(range(len(xs)), [f"{v:g}" for v in xs])
    axis.set_yticks(range(len(ys)), [f"{v:g}" for v in ys])
    axis.set_xlabel(SYMBOLS[columns[0]])
    axis.set_ylabel(SYMBOLS[columns[1]])
    a, b = PAPER[columns[0]], PAPER[columns[1]]
    if a in xs and b in ys:
        at = (int(np.flatnonzero(xs == a)[0]), int(np.flatnonzero(ys == b)[0]))
        axis.plot(*at, marker="s", markersize=22, fillstyle="none", markeredgewidth=2.0, color="#D55E00")
        axis.set_title("best of the pair; square: the paper's optimum", fontsize=8)


def _draw_spread(axis: Any, values: FloatArray, errors: FloatArray, column: int, linear: float) -> None:
    """Quartiles and best of all settings that share a value."""
    for k, (marker, colour) in enumerate((("o", "#0072B2"), ("^", "#D55E00"))):
        found = np.unique(values[:, k])
        parts = {v: errors[(values[:, k] == v) & np.isfinite(errors)] for v in found}
        at = np.flatnonzero([len(parts[v]) > 0 for v in found]) + 0.12 * (2 * k - 1)
        low, middle, high = np.array([np.quantile(part, (0.25, 0.5, 0.75)) for part in parts.values() if len(part)]).T
        axis.errorbar(
            at, middle, [middle - low, high - middle], fmt=marker, color=colour, capsize=3, markersize=5,
            label=f"{SYMBOLS[column + k]}: " + ", ".join(f"{v:g}" for v in found),
        )  # fmt: skip
        axis.plot(
            at,
            [part.min() for part in parts.values() if len(part)],
            linestyle="none",
            marker="_",
            markersize=12,
            color=colour,
        )
    axis.axhline(linear, color="black", linestyle="--", linewidth=1.0, label="LINEAR")
    axis.set_xticks([])
    axis.set_xlabel("in the order of the legend; dash: best")
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + LEGEND_SHARE * (high - low))
    axis.legend(fontsize=7, loc="upper right")
