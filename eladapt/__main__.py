"""``python -m eladapt``: the command line."""

import sys

from eladapt.cli import main

sys.exit(main())
