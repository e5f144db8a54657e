"""Pictures of scored trajectories: top view, error boxes by path length and by scene, error against distance.

Matplotlib is imported when a picture is drawn. Every method keeps its colour in all pictures of a run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mixo_env.files import atomic_path
from mixo_env.geometry import FloatArray
from mixo_env.metrics.absolute import scene_absolute
from mixo_env.metrics.relative import RelativeSamples
from mixo_env.metrics.tracks import BoolArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mixo_env.scoring.scores import Convention, MethodScore

TRUTH_COLOUR = "0.25"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f3b08", "#8c8c8c")
"""Okabe and Ito's palette and two more: told apart by colour-blind readers; methods take them in their order."""

EVENTS = {"initialising": ("#d62728", "o"), "lost": ("#1f4fd8", "x")}
"""Event -> colour and mark, as in the paper's Fig. 4: red while initialising, blue while lost."""

STRETCHES = 25
"""Stretches of the way over which errors against distance are summarised."""

LEAST_SCENES = 5
"""The summary ends where fewer scenes go on."""

Path2D = tuple[FloatArray, FloatArray]
"""x and y, ``(N,)`` each [m]."""

SceneErrors = tuple[FloatArray, FloatArray, FloatArray]
"""Distance travelled [m], translation error [m] and rotation error [deg] of one scene, ``(N,)`` each."""


def colours(methods: Sequence[str]) -> dict[str, str]:
    """One colour per method, the same in every picture; the palette starts again after its end."""
    return {method: COLOURS[k % len(COLOURS)] for k, method in enumerate(methods)}


def top_view(
    truth: Path2D,
    estimates: Mapping[str, Path2D],
    events: Mapping[str, Mapping[str, BoolArray]] | None = None,
    title: str = "",
) -> Figure:
    """Paths from above with equal axes.

    Args:
        truth: the true path.
        estimates: method -> path.
        events: method -> event in ``EVENTS`` -> ``(N,)`` poses to mark.
        title: what is shown, with its alignment.
    """
    figure, axes = _figure(6.0, 6.0)
    palette = colours(list(estimates))
    axes.plot(*truth, color=TRUTH_COLOUR, linewidth=2.5, label="ground truth")
    for method, (x, y) in estimates.items():
        axes.plot(x, y, color=palette[method], linewidth=1.3, label=method)
        for event, rows in (events or {}).get(method, {}).items():
            colour, mark = EVENTS[event]
            name = f"{event} ({method})" if len(estimates) > 1 else event
            axes.plot(x[rows], y[rows], linestyle="none", marker=mark, markersize=4, color=colour, label=name)
    axes.plot(truth[0][0], truth[1][0], marker="^", markersize=9, color=TRUTH_COLOUR, linestyle="none", label="start")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]", title=title)
    axes.grid(color="0.9")
    axes.legend(fontsize=8)
    return figure


def rte_boxes(samples: Mapping[str, RelativeSamples], title: str = "") -> Figure:
    """Relative errors by path length, methods side by side (the paper's Fig. 7): translation above, rotation below.

    Boxes hold the middle half, whiskers reach 1.5 interquartile ranges, outliers are not drawn; the number of samples
    stands below each length. A length without a sample in any method is left out.
    """
    figure, (above, below) = _figure(9.0, 6.5, rows=2)
    first = next(iter(samples.values()))
    lengths = [length for length in first.lengths_m if any(np.any(s.length_m == length) for s in samples.values())]
    counts = [int(np.count_nonzero(first.length_m == length)) for length in lengths]
    for axes, name, label in (
        (above, "translation_percent", "translation error [%]"),
        (below, "rotation_deg_per_m", "rotation error [deg/m]"),
    ):
        groups = {
            method: [getattr(one, name)[one.length_m == length] for length in lengths]
            for method, one in samples.items()
        }
        _grouped_boxes(axes, groups)
        axes.set(ylabel=label)
        axes.set_ylim(bottom=0.0)
    above.set(title=title)
    above.tick_params(labelbottom=False)
    below.set_xticks(
        range(len(lengths)), [f"{length:g}\n{count}" for length, count in zip(lengths, counts, strict=True)]
    )
    below.set(xlabel="path length [m], and number of samples")
    _legend(above, list(samples))
    return figure


def ate_boxes(ate_m: Mapping[str, FloatArray], title: str = "", limit_m: float | None = 0.5) -> Figure:
    """Per-scene ATE of each method (the paper's Fig. 6): a box, and every scene as a dot.

    Args:
        ate_m: method -> ``(scenes,)``.
        title: what is shown, with its alignment.
        limit_m: a dashed line, with the share of scenes above it in the labels; ``None``: none.
    """
    figure, axes = _figure(1.5 + 1.4 * max(len(ate_m), 2), 4.5)
    _grouped_boxes(axes, {method: [values] for method, values in ate_m.items()}, width=0.8)
    rng = np.random.default_rng(0)
    positions = _positions(len(ate_m), 0.8)
    for position, values in zip(positions, ate_m.values(), strict=True):
        spread = position + 0.25 * (0.8 / len(ate_m)) * rng.uniform(-1, 1, len(values))
        axes.plot(spread, values, linestyle="none", marker=".", markersize=4, color="0.2", alpha=0.6)
    labels = list(ate_m)
    if limit_m is not None:
        axes.axhline(limit_m, color="0.5", linestyle="--", linewidth=0.8)
        labels = [f"{method}\n{np.mean(values > limit_m):.0%} > {limit_m:g} m" for method, values in ate_m.items()]
    axes.set_xticks(positions, labels)
    axes.set(ylabel="ATE of a scene [m]", title=title)
    axes.set_ylim(bottom=0.0)
    return figure


def error_by_distance(errors: Mapping[str, Sequence[SceneErrors]], title: str = "") -> Figure:
    """Position and rotation error along the way: every scene as a line, and the median where there are several.

    The median of a stretch is taken over the poses of all scenes in it, up to where at least five reach; the
    band holds their middle half.

    Args:
        errors: method -> its scenes.
        title: what is shown, with its alignment.
    """
    figure, both = _figure(8.0, 5.5, rows=2)
    palette = colours(list(errors))
    for method, scenes in errors.items():
        several = len(scenes) > 1
        faint = {"linewidth": 0.5, "alpha": 0.3} if several else {"linewidth": 1.3}
        for k, axes in enumerate(both):
            for distance, *values in scenes:
                axes.plot(distance, values[k], color=palette[method], **faint)
            if several:
                middle, low, median, high = _quartiles([(scene[0], scene[k + 1]) for scene in scenes])
                axes.fill_between(middle, low, high, color=palette[method], alpha=0.2, linewidth=0)
                axes.plot(middle, median, color=palette[method], linewidth=2.2)
    above, below = both
    above.set(ylabel="translation error [m]", title=title)
    above.tick_params(labelbottom=False)
    below.set(ylabel="rotation error [deg]", xlabel="distance travelled [m]")
    for axes in both:
        axes.set_ylim(bottom=0.0)
        axes.grid(color="0.9")
    _legend(above, list(errors))
    return figure


def draw_all(folder: Path, scores: Sequence[MethodScore], convention: Convention) -> None:
    """Write every picture of a scored set of methods into ``folder`` as PNG.

    Args:
        folder: exists.
        scores: of the methods, on the same scenes.
        convention: printed above each picture, as far as it matters there.
    """
    aligned = convention.alignment_words()
    scenes = scores[0].matched.scenes
    (folder / "top_view").mkdir(exist_ok=True)
    for index, scene in enumerate(scenes):
        estimates = {method.name: _seen_from_above(method, index) for method in scores}
        truth = scores[0].matched.truth[scores[0].rows(index)].planar()[:2]
        save(top_view(truth, estimates, title=f"{scene}: {aligned}"), folder / "top_view" / f"{scene}.png")
    if any(len(method.relative.scene) for method in scores):
        samples = {method.name: method.relative for method in scores}
        save(rte_boxes(samples, convention.sentence().replace("; ", "\n")), folder / "rte_by_length.png")
    ates, errors = {}, {}
    for method in scores:
        rows = [method.rows(k) for k in range(len(scenes))]
        translation_m, rotation_deg = method.absolute.translation_m, method.absolute.rotation_deg
        ates[method.name] = scene_absolute(method.absolute, method.matched.offsets).translation_m
        errors[method.name] = [(method.distance_m[r], translation_m[r], rotation_deg[r]) for r in rows]
    save(ate_boxes(ates, aligned), folder / "ate_by_scene.png")
    save(error_by_distance(errors, aligned), folder / "error_by_distance.png")


def save(figure: Figure, path: Path) -> None:
    """Write a picture at once or not at all, in the format its suffix names.

    Raises:
        OutputError: when it cannot be written.
    """
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=path.suffix[1:], dpi=150)


def _seen_from_above(method: MethodScore, scene: int) -> Path2D:
    x, y, _ = method.aligned[method.rows(scene)].planar()
    return x, y


def _figure(width: float, height: float, rows: int = 1) -> tuple[Figure, Any]:
    """A figure of ``rows`` axes below one another, outside pyplot's global state."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, 1)


def _positions(count: int, width: float) -> FloatArray:
    """Centres of ``count`` boxes side by side around 0, together ``width`` wide."""
    return width * ((np.arange(count) + 0.5) / count - 0.5)


def _quartiles(scenes: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, ...]:
    """Middle of each stretch of the way that enough scenes reach, and the quartiles of their values in it."""
    reach = np.sort([distance[-1] for distance, _ in scenes])
    edges = np.linspace(0.0, max(reach[-min(LEAST_SCENES, len(reach))], 1e-9), STRETCHES + 1)
    distance, values = (np.concatenate(parts) for parts in zip(*scenes, strict=True))
    stretch = np.digitize(distance, edges) - 1
    filled = np.array([k for k in range(STRETCHES) if np.any(stretch == k)])
    low, median, high = np.array([np.percentile(values[stretch == k], [25, 50, 75]) for k in filled]).T
    return 0.5 * (edges[filled] + edges[filled + 1]), low, median, high


def _grouped_boxes(axes: Axes, groups: Mapping[str, Sequence[FloatArray]], width: float = 0.8) -> None:
    """Boxes of each method at 0, 1, 2 ..., the methods of one position side by side in their colours."""
    palette = colours(list(groups))
    for shift, (method, values) in zip(_positions(len(groups), width), groups.items(), strict=True):
        filled = [k for k, one in enumerate(values) if len(one)]
        axes.boxplot(
            [values[k] for k in filled],
            positions=[k + shift for k in filled],
            widths=0.85 * width / len(groups),
            whis=1.5,
            showfliers=False,
            patch_artist=True,
            manage_ticks=False,
            boxprops={"facecolor": palette[method], "alpha": 0.55, "edgecolor": palette[method]},
            medianprops={"color": "black"},
            whiskerprops={"color": palette[method]},
            capprops={"color": palette[method]},
        )
    axes.grid(axis="y", color="0.9")
    axes.set_axisbelow(True)


def _legend(axes: Axes, methods: Sequence[str]) -> None:
    from matplotlib.patches import Patch

    palette = colours(methods)
    axes.legend(handles=[Patch(color=palette[method], label=method) for method in methods], fontsize=8, ncols=4)
