"""The folder for ``PYTHONPATH``: all that it holds is ``MatterSim.py``."""
