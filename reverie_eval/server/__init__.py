"""The evaluation server: scores uploads within the request and keeps what it accepted.

Imported by the commands ``serve`` and ``server`` only.
"""
