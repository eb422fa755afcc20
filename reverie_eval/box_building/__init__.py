"""Boxes in the published layout, built from Matterport's ``.house`` files and camera poses."""
