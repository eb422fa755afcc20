"""The environment variables that are read, besides those that change a server's settings."""

PREFIX = "REVERIE_EVAL_"
"""What the names of all of them begin with, and those of the settings too."""

GROUND_TRUTH = f"{PREFIX}GROUND_TRUTH"
"""The folder of bundles, or the bundle, that submissions are scored by."""
SERVER = f"{PREFIX}SERVER"
"""The evaluation server that a client talks to."""
TOKEN = f"{PREFIX}TOKEN"
"""Who is calling it."""
