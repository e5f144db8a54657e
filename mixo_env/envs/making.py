"""What Gymnasium hands an environment when it makes one: checked arguments, and the specification it is made from."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

from mixo_env.envs.faults import Fault
from mixo_env.errors import ConfigurationError, unknown

RENDER_MODES = ["ansi", "rgb_array"]


class PlainSpec:
    """An environment whose specification holds plain values only, so that it can be written as JSON."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium made the environment."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = plain_spec(spec)


def plain_spec(spec: EnvSpec | None) -> EnvSpec | None:
    """The specification with paths as text and faults as dictionaries, which is what JSON can hold."""
    if spec is None:
        return None

    def plain(value: Any) -> Any:
        if isinstance(value, Path):
            return str(value)
        if isinstance(value, Fault):
            return asdict(value)
        return [plain(one) for one in value] if isinstance(value, list | tuple) else value

    return replace(spec, kwargs={name: plain(value) for name, value in spec.kwargs.items()})


def checked_count(name: str, value: Any) -> int:
    """The number, if it is a whole one above 0."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise ConfigurationError(f"{name}: expected a whole number >= 1, got {value!r}: e.g. 64")
    return int(value)


def checked_render_mode(mode: str | None) -> str | None:
    """The mode, if it is one."""
    if mode is not None and mode not in RENDER_MODES:
        raise ConfigurationError(unknown("render_mode", mode, RENDER_MODES))
    return mode


def checked_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """The mode as Gymnasium's enum, from its value or its name."""
    if isinstance(mode, AutoresetMode):
        return mode
    modes = {key: m for m in AutoresetMode for key in (m.value, m.name)}
    if not isinstance(mode, str) or mode not in modes:
        raise ConfigurationError(unknown("autoreset_mode", mode, [m.name for m in AutoresetMode]))
    return modes[mode]
