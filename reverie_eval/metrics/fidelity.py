"""How closely the trajectory follows the annotated path: one value per episode.

All four are computed for many episodes at once. Episodes of different lengths share one dynamic
programme: cells beyond an episode's own table are never read by it.
"""
