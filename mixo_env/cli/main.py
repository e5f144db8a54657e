"""The console script ``mixo``: one subcommand per module of this package."""

from __future__ import annotations

import logging
import os
import sys
from typing import ClassVar, Protocol

DESCRIPTION = """MixoOdometry: how much to trust each camera of a car's rig.

`mixo benchmark` needs nothing; `mixo COMMAND --help` shows worked examples. Exit codes: 0 good, 1 something wrong in
the data, 2 wrong usage. `-v` says more about what happens, `--version` which version this is. Completion by the tab
key: `source <(mixo --tyro-print-completion bash)` (or zsh, fish).
"""


class Command(Protocol):
    """A frozen dataclass whose fields are the command line."""

    interrupted: ClassVar[str]
    """What is left when it is stopped half-way, and how to go on."""

    def run(self) -> int:
        """Do the work and return the exit code: 0 good, 1 something wrong in the data, 2 wrong usage."""
        ...


def commands() -> dict[str, type]:
    """Subcommand name -> dataclass. Importing them must stay cheap: `mixo --help` is instant."""
    from mixo_env.cli.benchmark import Benchmark
    from mixo_env.cli.evaluate import Evaluate
    from mixo_env.cli.export import Export
    from mixo_env.cli.import_ import Import
    from mixo_env.cli.inspect import Inspect
    from mixo_env.cli.record import Record
    from mixo_env.cli.report import Report
    from mixo_env.cli.score import Score
    from mixo_env.cli.search import Search
    from mixo_env.cli.simulate import Simulate
    from mixo_env.cli.train import Train
    from mixo_env.cli.train_vocabulary import TrainVocabulary
    from mixo_env.cli.view import View

    return {
        "benchmark": Benchmark,
        "report": Report,
        "view": View,
        "score": Score,
        "train": Train,
        "search": Search,
        "simulate": Simulate,
        "inspect": Inspect,
        "record": Record,
        "import": Import,
        "export": Export,
        "evaluate": Evaluate,
        "train-vocabulary": TrainVocabulary,
    }


class _Printable(logging.Formatter):
    """Log lines may quote names and errors from files: what would move the cursor is shown as an escape."""

    def format(self, record: logging.LogRecord) -> str:
        """The message on one line."""
        from mixo_env.errors import printable

        return printable(super().format(record))


def main(argv: list[str] | None = None) -> int:
    """Parse ``argv`` (default: the process arguments), run the command, return its exit code.

    Where the reader of the output goes away (``mixo ... | head``), the command ends quietly, as a killed one would.
    """
    try:
        try:
            return run(sys.argv[1:] if argv is None else argv)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter complains when it flushes
        return 141  # what a shell reports of a command that SIGPIPE ended


def run(arguments: list[str]) -> int:
    """Parse ``arguments``, run the command, and turn the errors a user can cause into a line and an exit code."""
    import tyro

    from mixo_env.errors import ConfigurationError, MixoError, printable

    if arguments == ["--version"]:
        from mixo_env import __version__

        print(f"mixo {__version__}")
        return 0
    verbose = "-v" in arguments
    handler = logging.StreamHandler()
    handler.setFormatter(_Printable("%(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.INFO if verbose else logging.WARNING)
    left = "nothing was done"
    try:
        try:
            command: Command = tyro.extras.subcommand_cli_from_dict(
                commands(),
                prog="mixo",
                description=DESCRIPTION,
                args=[argument for argument in arguments if argument != "-v"],
            )
        except ImportError as error:
            raise ConfigurationError("completion is written for bash, zsh and fish: name one of these") from error
        except BrokenPipeError:
            raise
        except OSError as error:
            raise ConfigurationError(f"the completion was not written: {error}: name a folder that exists") from error
        left = command.interrupted
        return command.run()
    except ConfigurationError as error:
        print(f"mixo: {printable(str(error))}", file=sys.stderr)
        return 2
    except MixoError as error:
        print(f"mixo: {printable(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"mixo: interrupted; {left}", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
