"""The data sheet of the simulated city: ``python -m docs._pages.data_sheet``."""
