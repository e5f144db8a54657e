"""Write docs/environment.md from the docstrings of the environments, which are their specification.

python -m docs._pages.environment_page
"""

from __future__ import annotations

import inspect
from pathlib import Path

from mixo_env import ENVIRONMENTS
from mixo_env.envs.budget import MixoOdometryBudgetEnv
from mixo_env.envs.observation import Quantity
from mixo_env.envs.odometry import MixoOdometryEnv
from mixo_env.files import write_text

PAGE = Path(__file__).parents[1] / "environment.md"

CLASSES = dict(zip(ENVIRONMENTS, (MixoOdometryEnv, MixoOdometryBudgetEnv), strict=True))

HEAD = """# The environments

<!-- Written by `python -m docs._pages.environment_page` from the docstrings; change those. -->

"""

WIDTHS = {"one": "1", "camera": "C", "expert": "N"}


def observation_table(quantities: tuple[Quantity, ...]) -> str:
    """Markdown table of ``quantities``, which the docstrings must contain word for word."""
    rows = ["| name | width | range | unit | meaning |", "|---|---|---|---|---|"]
    rows += [
        f"| `{q.name}` | {WIDTHS[q.per]} | {q.low:.5g} to {q.high:.5g} | {q.unit} | {q.meaning} |" for q in quantities
    ]
    return "\n".join(rows)


def page() -> str:
    """The whole page; sections move one level down, under the environment's id."""
    parts = [HEAD.rstrip()]
    for env_id, env_class in CLASSES.items():
        text = inspect.cleandoc(env_class.__doc__ or "")
        parts.append(f"## {env_id}\n\n" + text.replace("\n## ", "\n### "))
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    write_text(PAGE, page())
    print(f"wrote {PAGE}")
