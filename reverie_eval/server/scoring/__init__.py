"""The splits with their ground truth in memory, and the processes that score."""
