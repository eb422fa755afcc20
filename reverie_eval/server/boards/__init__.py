"""Leaderboards: their entries, ranks, phases, reviews, reported results, news and feeds."""
