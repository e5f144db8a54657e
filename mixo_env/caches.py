"""Where things are kept between runs that can be made again."""

from __future__ import annotations

import os
from pathlib import Path


def user_cache_folder() -> Path:
    """The project's folder in ``$XDG_CACHE_HOME``, else in ``~/.cache``; it need not exist, nor be possible to make."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base).absolute() if base else Path.home() / ".cache") / "mixo-env"
    except RuntimeError:  # a user without a home: nothing can be made below a file
        return Path(os.devnull) / "mixo-env"
