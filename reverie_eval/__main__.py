"""``python -m reverie_eval`` is the command ``reverie-eval``."""

import runpy

# By name: the package does not import its command line.
runpy.run_module("reverie_eval_cli", run_name="__main__", alter_sys=True)
