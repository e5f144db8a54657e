"""The data sheet of the simulated city: ``python -m experiments.data_sheet``."""
