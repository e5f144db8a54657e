"""Tables and pictures of scored trajectories."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

from mixo_env.metrics.pairs import PairRule
from mixo_env.scoring.score_figures import COLOURS, ate_boxes, error_by_distance, rte_boxes, top_view
from mixo_env.scoring.scores import Convention, join, score
from mixo_env.tables import Column, Table
from tests.trajectories import disturbed, drive

TABLE = Table(
    "A_1 & 50 %",
    (Column("Method"), Column("RTE", "%", ".2f"), Column("n", spec="d")),
    [["a|b_c", 1.2345, 3], ["x", float("nan"), None]],
)


def test_text_aligns_and_marks_missing_values():
    lines = TABLE.text().splitlines()
    assert lines[0] == "A_1 & 50 %"
    assert lines[3].split() == ["a|b_c", "1.23", "3"]
    assert lines[4].split() == ["x", "-", "-"]
    assert len({line.rstrip()[-1] for line in lines[3:]}) == 2


def test_csv_keeps_all_digits():
    rows = list(csv.reader(io.StringIO(TABLE.csv())))
    assert rows == [["Method", "RTE [%]", "n"], ["a|b_c", "1.2345", "3"], ["x", "", ""]]


@pytest.mark.parametrize("name", ["=1+1", "+1", "-1", "@SUM(A1)", " =1", "＝1"])
def test_text_in_csv_is_no_formula_and_numbers_stay_numbers(name):
    rows = list(csv.reader(io.StringIO(Table("", (Column("a"), Column("b")), [[name, -1.5], ["a-b", -2]]).csv())))
    assert rows[1:] == [[f"'{name}", "-1.5"], ["a-b", "-2"]]


def test_names_from_data_act_on_no_terminal():
    table = Table("", (Column("a"),), [["\x1b[2Ja\nb"]])
    for text in (table.text(), table.csv(), table.markdown(), table.latex()):
        assert "\x1b" not in text
        assert "a\nb" not in text


def test_long_names_wrap_to_the_terminal_and_groups_stand_apart():
    table = Table("A caption", (Column("name"), Column("n")), [["one long name of a row", 1], ["b", 22]], begins=(1,))
    assert table.text(14).splitlines() == [
        "A caption",
        "name         n",
        "-" * 14,
        "one long     1",
        "name of a",
        "row",
        "",
        "b           22",
    ]
    assert table.text().splitlines()[3:] == ["one long name of a row   1", "", "b                       22"]


def test_markdown_and_latex_escape_their_own_signs():
    assert r"| a\|b_c | 1.23 | 3 |" in TABLE.markdown()
    latex = TABLE.latex()
    assert r"\caption{A\_1 \& 50 \%}" in latex
    assert r"a|b\_c & 1.23 & 3 \\" in latex
    assert "{lrr}" in latex


def test_a_row_must_fill_the_columns():
    with pytest.raises(ValueError, match="zip"):
        Table("", (Column("a"), Column("b")), [["x"]]).text()


@pytest.fixture(scope="module")
def methods():
    rng = np.random.default_rng(0)
    truths = {f"scene-{k}": drive(rng, 100) for k in range(6)}
    convention = Convention(pair_rule=PairRule((5.0, 10.0, 500.0)))
    return [
        score(join(name, {scene: (truth, disturbed(rng, truth)) for scene, truth in truths.items()}), convention)
        for name in ("front", "mixo")
    ]


def test_top_view_has_equal_axes_and_marks_events():
    x = np.arange(10.0)
    lost = x > 6
    axes = top_view((x, x), {"front": (x, x + 1)}, {"front": {"lost": lost}}, "a title").axes[0]
    assert axes.get_aspect() == 1.0
    assert {text.get_text() for text in axes.get_legend().get_texts()} == {"ground truth", "front", "lost", "start"}
    marked = next(line for line in axes.get_lines() if line.get_label() == "lost")
    np.testing.assert_array_equal(marked.get_xdata(), x[lost])


def test_boxes_stand_side_by_side_in_fixed_colours(methods):
    figure = rte_boxes({method.name: method.relative for method in methods})
    for axes in figure.axes:
        boxes = [patch for patch in axes.patches if patch.get_facecolor()[3] < 1]
        assert len(boxes) == 4  # two methods at two lengths; 500 m has no sample
        faces = [tuple(round(255 * c) for c in box.get_facecolor()[:3]) for box in boxes]
        expected = [tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5)) for colour in COLOURS[:2]]
        assert faces == [expected[0], expected[0], expected[1], expected[1]]
    labels = [label.get_text() for label in figure.axes[1].get_xticklabels()]
    assert [label.split("\n")[0] for label in labels] == ["5", "10"]


def test_every_scene_is_a_dot_and_the_share_above_the_limit_is_named():
    axes = ate_boxes({"front": np.array([0.1, 0.4, 0.9, 1.2]), "mixo": np.array([0.1, 0.2, 0.2, 0.3])}).axes[0]
    labels = [label.get_text() for label in axes.get_xticklabels()]
    assert labels == ["front\n50% > 0.5 m", "mixo\n0% > 0.5 m"]
    assert sorted(len(line.get_xdata()) for line in axes.get_lines() if line.get_marker() == ".") == [4, 4]


def test_error_against_distance_draws_every_scene_and_a_median(methods):
    errors = {
        method.name: [
            (method.distance_m[method.rows(k)], method.absolute.translation_m[method.rows(k)], np.ones(100))
            for k in range(6)
        ]
        for method in methods
    }
    assert [len(axes.get_lines()) for axes in error_by_distance(errors).axes] == [14, 14]
    single = {name: scenes[:1] for name, scenes in errors.items()}
    assert [len(axes.get_lines()) for axes in error_by_distance(single).axes] == [2, 2]
