"""The command line: ``reverie-eval``."""
