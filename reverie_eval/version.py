"""The version, stated once: the package, the distribution and every signature read it here."""

__version__ = "0.1.0"
