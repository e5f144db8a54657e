"""Other people's programs as yardsticks: each in a virtual environment of its own, spoken to by files and pipes.

Some are under the GPL, so nothing here imports them into this project's process; comparisons skip when they are absent.
"""
