"""The paper's tables and figures, on its own track: `mixo benchmark --paper`; further options go through to it.

python -m experiments.paper --recordings paper736
"""

import sys

from mixo_env.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["benchmark", "--paper", "--tracks", "PAPER", *sys.argv[1:]]))
