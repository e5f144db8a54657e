"""One module per `mixo` command: a frozen dataclass that is also its command line, with a `run` method."""
