"""Progress without a terminal: lines now and then, with what is left; an interruption says what is kept."""

from __future__ import annotations

import pytest

from mixo_env.cli import main as cli
from mixo_env.cli import progress as module
from mixo_env.cli.progress import duration, progress


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(-1.0, "0 s"), (40.4, "40 s"), (60.0, "1 min 0 s"), (200.0, "3 min 20 s"), (7500.0, "2 h 5 min")],
)
def test_a_duration_is_said_as_people_say_it(seconds: float, said: str) -> None:
    assert duration(seconds) == said


def test_without_a_terminal_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    clock = iter([0.0, 5.0, 12.0, 15.0, 30.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with progress("doing things") as report:
        for done in (1, 3, 4, 9):  # after 5, 12, 15 and 30 s
            report(done, 10)
    captured = capsys.readouterr()
    assert captured.err == "doing things: 3 of 10, 28 s left\ndoing things: 9 of 10, 3 s left\n"
    assert captured.out == ""


def test_nothing_done_yet_has_no_time_left(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    clock = iter([0.0, 20.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with progress("doing things") as report:
        report(0, 10)
    assert capsys.readouterr().err == "doing things: 0 of 10\n"


@pytest.mark.parametrize("command", cli.commands().values())
def test_an_interruption_says_what_is_kept(
    command: type, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """Every command says so itself: only some of them go on where they were stopped."""

    def stop(_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run", stop)
    arguments = {
        "Benchmark": ["benchmark"],
        "Report": ["report", "results"],
        "Train": ["train", "LINEAR", "--out", "weights"],
        "Search": ["search"],
        "Score": ["score", "LINEAR"],
        "View": ["view"],
        "Simulate": ["simulate", "city"],
        "Inspect": ["inspect", "root"],
        "Record": ["record", "root", "--out", "out"],
        "Import": ["import", "rec", "--expert", "ORB=t", "--out", "out"],
        "Export": ["export", "mixocity", "--out", "out"],
        "Evaluate": ["evaluate", "--groundtruth", "a", "--estimate", "b"],
        "TrainVocabulary": ["train-vocabulary", "root", "--out", "out"],
    }
    assert cli.main(arguments[command.__name__]) == 130
    said = capsys.readouterr().err
    assert said == f"mixo: interrupted; {command.interrupted}\n"  # type: ignore[attr-defined]
    keeps = command.__name__ in ("Record", "Simulate", "Train", "Search")
    assert ("continues" in said) == keeps
