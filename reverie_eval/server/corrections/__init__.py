"""Scoring again after a correction, and snapshots of leaderboards."""
