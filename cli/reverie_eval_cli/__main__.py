"""``python -m reverie_eval_cli``."""

import sys

from reverie_eval_cli.main import main

sys.exit(main())
