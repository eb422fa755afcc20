"""The largest numbers that are taken from files of a dataset."""

LARGEST_OBJECT_ID = 2**31 - 1
"""Bundles hold object ids in 32 bits."""

FARTHEST = 1e6
"""Metres, along any axis, from a scan's origin to a camera or an object, and of half an object's
extent. No building comes near it, though a map in whose frame it stands may; what is beyond has
been misread, and its square might overflow."""
