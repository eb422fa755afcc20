"""An organiser's check of the published files: all splits, all scans, used by a task or not.

Compiling stops at the first file that a split cannot be scored with. Linting counts: it reads
whatever is there and says how much of it is how.
"""
