"""The version: the package, the distribution and every signature read it from here."""

__version__ = "0.1.0"
